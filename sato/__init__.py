"""Planning for swarms of vehicles: assignment, trajectories, formation, connectivity.

    import sato

    run = sato.run("uiuc", seed=1)
    print(run.summary["reached"], run.check().kept)
    run.save("runs/uiuc-1")

Names are imported when they are first used, for some take long.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dynamics import DoubleIntegrator
    from sato.connectivity.mission import Connectivity
    from sato.formation.leg import FormationLeg
    from sato.formation.mission import Formation
    from sato.reconfiguration.mission import Join, Leg, Loss, Reconfiguration
    from sato.record import RunFileError
    from sato.runs import Run, load, run, simulate
    from sato.scenario.errors import InputError, ScenarioError
    from sato.scenario.file import from_dict, parse, read, scenarios

_MODULES = {
    "Connectivity": "sato.connectivity.mission",
    "DoubleIntegrator": "dynamics",
    "Formation": "sato.formation.mission",
    "FormationLeg": "sato.formation.leg",
    "InputError": "sato.scenario.errors",
    "Join": "sato.reconfiguration.mission",
    "Leg": "sato.reconfiguration.mission",
    "Loss": "sato.reconfiguration.mission",
    "Reconfiguration": "sato.reconfiguration.mission",
    "Run": "sato.runs",
    "RunFileError": "sato.record",
    "ScenarioError": "sato.scenario.errors",
    "from_dict": "sato.scenario.file",
    "load": "sato.runs",
    "parse": "sato.scenario.file",
    "read": "sato.scenario.file",
    "run": "sato.runs",
    "scenarios": "sato.scenario.file",
    "simulate": "sato.runs",
}

__all__ = [
    "Connectivity",
    "DoubleIntegrator",
    "Formation",
    "FormationLeg",
    "InputError",
    "Join",
    "Leg",
    "Loss",
    "Reconfiguration",
    "Run",
    "RunFileError",
    "ScenarioError",
    "from_dict",
    "load",
    "parse",
    "read",
    "run",
    "scenarios",
    "simulate",
]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("sato-swarm")
    if name in _MODULES:
        return getattr(import_module(_MODULES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
