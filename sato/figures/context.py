"""Settings under which all figures are drawn, whatever matplotlib's own file of the user says."""

from contextlib import AbstractContextManager

from matplotlib import style

from sato.figures.style import STYLE


def styled() -> AbstractContextManager[None]:
    """Return a context in which matplotlib has its defaults, and the settings of our figures."""
    return style.context(["default", STYLE])
