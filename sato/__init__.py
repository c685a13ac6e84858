"""Planning for swarms of vehicles: who goes where, and how to get there.

    import sato

    run = sato.run("uiuc", seed=1)
    print(run.summary["reached"], run.check().kept)
    run.save("runs/uiuc-1")

What takes long to import is imported when it is asked for.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sato.former import ScenarioError, ScenarioFile, names, parse, read
    from sato.record import Run, RunFileError, load
    from sato.simulate import run

_LAZY_IMPORTS = {
    "run": "sato.simulate",
    "Run": "sato.record",
    "RunFileError": "sato.record",
    "load": "sato.record",
    "ScenarioError": "sato.former",
    "ScenarioFile": "sato.former",
    "parse": "sato.former",
    "read": "sato.former",
    "names": "sato.former",
}

__all__ = [
    "Run",
    "RunFileError",
    "ScenarioError",
    "ScenarioFile",
    "load",
    "names",
    "parse",
    "read",
    "run",
]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("sato-swarm")
    if name in _LAZY_IMPORTS:
        return getattr(import_module(_LAZY_IMPORTS[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *_LAZY_IMPORTS, "__version__"])
