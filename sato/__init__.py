"""Planning for swarms of vehicles: assignment, trajectories, formation, connectivity.

    import sato

    run = sato.run("uiuc", seed=1)
    print(run.summary["reached"], run.check().kept)
    run.save("runs/uiuc-1")

A name is imported from its module when it is first used, so that `import sato` is fast.
"""
# mypy: implicit-reexport
# ruff: noqa: F401

from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dynamics import (
        J2,
        ClohessyWiltshire,
        DoubleIntegrator,
        InertialPlant,
        LinearModel,
        LinearPlant,
        NonlinearModel,
        NonlinearPlant,
        Orbit,
        Plant,
        SchweighartSedwick,
        SymbolicModel,
        TschaunerHempel,
    )
    from problems import GainMatrix, Infeasible, Trajectory, TransferProblem, Unsolved, design_gains
    from sato.campaigns.engine import campaign
    from sato.connectivity.mission import AgentLoss, Connectivity
    from sato.formation.leg import FormationLeg
    from sato.formation.mission import Formation
    from sato.obstacles import Box, Ellipsoid, Polytope, Sphere
    from sato.reconfiguration.agent import Agent
    from sato.reconfiguration.central import central_problem
    from sato.reconfiguration.first_commitment import find_first_commitments
    from sato.reconfiguration.leg import Join, Leg, Loss
    from sato.reconfiguration.mission import Reconfiguration
    from sato.reconfiguration.models import PlantSettings
    from sato.reconfiguration.orbit import Chief
    from sato.reconfiguration.start import Random
    from sato.record import RunFileError
    from sato.runs import Run, load, run, simulate
    from sato.scenario.errors import InputError, ScenarioError
    from sato.scenario.file import from_dict, parse, read, scenarios
    from sato.shapes import Lattice, Picture, Points, Polygon, Ring, Text

_PUBLIC = {
    "dynamics": (
        "ClohessyWiltshire DoubleIntegrator InertialPlant J2 LinearModel LinearPlant "
        "NonlinearModel NonlinearPlant Orbit Plant SchweighartSedwick SymbolicModel TschaunerHempel"
    ),
    "problems": "GainMatrix Infeasible Trajectory TransferProblem Unsolved design_gains",
    "sato.campaigns.engine": "campaign",
    "sato.connectivity.mission": "AgentLoss Connectivity",
    "sato.formation.leg": "FormationLeg",
    "sato.formation.mission": "Formation",
    "sato.obstacles": "Box Ellipsoid Polytope Sphere",
    "sato.reconfiguration.agent": "Agent",
    "sato.reconfiguration.first_commitment": "find_first_commitments",
    "sato.reconfiguration.leg": "Join Leg Loss",
    "sato.reconfiguration.central": "central_problem",
    "sato.reconfiguration.mission": "Reconfiguration",
    "sato.reconfiguration.models": "PlantSettings",
    "sato.reconfiguration.orbit": "Chief",
    "sato.reconfiguration.start": "Random",
    "sato.record": "RunFileError",
    "sato.runs": "Run load run simulate",
    "sato.scenario.errors": "InputError ScenarioError",
    "sato.scenario.file": "from_dict parse read scenarios",
    "sato.shapes": "Lattice Picture Points Polygon Ring Text",
}
_MODULES = {name: module for module, names in _PUBLIC.items() for name in names.split()}

__all__ = sorted(_MODULES)


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("sato-swarm")
    check_packages()
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = found = getattr(import_module(_MODULES[name]), name)
    return found


@cache
def check_packages() -> None:
    """Refuse modules of the user's that hide the packages on which this one rests."""
    for name in ("dynamics", "problems"):
        spec, wanted = find_spec(name), Path(__file__).resolve().parents[1] / name
        places = (spec and spec.submodule_search_locations) or ()
        if wanted not in [Path(place).resolve() for place in places]:
            reason = f"{spec.origin if spec else name} hides {wanted}, on which sato rests"
            raise ImportError(f"{reason}; another name of the file would do")


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
