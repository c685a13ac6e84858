"""Notice of compilation: one line on the error stream as soon as kernels are compiled."""

import sys
from contextlib import AbstractContextManager, nullcontext

from numba.core import event

NOTICE = "compiling kernels, once after an installation: about 10 s"


class _Notice(event.Listener):  # type: ignore[misc]  # numba has no types
    def __init__(self) -> None:
        self.is_given = False

    def on_start(self, event: object) -> None:
        """Print the notice when the first kernel is compiled, and not read from the cache."""
        if not self.is_given:
            self.is_given = True
            print(NOTICE, file=sys.stderr, flush=True)

    def on_end(self, event: object) -> None:
        """Do nothing."""


def announce_compilation(is_shown: bool = True) -> AbstractContextManager[None]:
    """Print a line when kernels are compiled in a block, which takes seconds; once a process."""
    return event.install_listener("numba:compile", _notice) if is_shown else nullcontext()


def announce_all() -> None:
    """Print a line when this process first compiles kernels, as a worker of a campaign may."""
    event.register("numba:compile", _notice)


_notice = _Notice()
