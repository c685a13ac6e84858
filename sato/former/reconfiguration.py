"""SYSTEM 1 as a file."""

import warnings
from typing import Annotated, Any, Literal

import numpy as np
import tomli_w
from pydantic import Field, model_validator

from sato.reconfiguration.mission import Reconfiguration
from sato.former.build import build
from sato.former.detect import check_detectable, detectable
from sato.former.file import ScenarioFile
from sato.former.legs import check_legs, wanted
from sato.former.models import AnyModel
from sato.former.orbital import Chief, PlantTable
from sato.former.reach import check_reach
from sato.former.start import portable
from sato.former.tables import Disturbance, LegTable, Plan, Swarm, check_noise, check_plan
from sato.former.validity import doubt
from sato.former.world import World, check_kinds, check_world


class ReconfigurationFile(ScenarioFile):
    """A swarm that takes up one shape after another, as it stands in a file."""

    system: Literal["reconfiguration"]
    swarm: Swarm
    chief: Chief | None = None
    model: AnyModel
    plant: PlantTable = PlantTable()
    plan: Plan
    disturbance: Disturbance = Disturbance()
    leg: Annotated[list[LegTable], Field(min_length=1)]

    @model_validator(mode="before")
    @classmethod
    def _often_where_it_goes_wrong(cls, data: Any) -> Any:
        # What is not said of the periods follows from the horizon, or from what goes wrong.
        if not isinstance(data, dict):
            return data
        check_kinds(data)
        plan, shaken, plant = (data.get(key) or {} for key in ("plan", "disturbance", "plant"))
        if not all(isinstance(table, dict) for table in (plan, shaken, plant)) or not plan:
            return data
        wrong = any(isinstance(size, int | float) and size > 0 for size in shaken.values())
        if not wrong and ("chief" not in data or plant.get("kind") == "model"):
            return data
        return data | {"plan": {"replan_steps": 1} | plan}

    @model_validator(mode="after")
    def _hangs_together(self) -> "ReconfigurationFile":
        check_world(self._world)
        check_detectable(self.swarm, self.model, self.plan)
        check_legs(self.swarm, self.leg)
        check_plan(self.plan, self.leg)
        check_noise(self.swarm, self.disturbance)
        return self

    @property
    def _world(self) -> World:
        return World(self.model, self.chief, self.plant)

    @property
    def undetectable(self) -> bool:
        """Whether two agents might meet unseen, against [Morgan2016, Prop. 9]."""
        return not detectable(self.swarm, self.model, self.plan)

    def build(self, rng: np.random.Generator) -> Reconfiguration:
        """The mission; random starts are drawn."""
        with self.building():
            mission = build(self.swarm, self._world, self.plan, self.disturbance, self.leg, rng)
            check_reach(mission)
        return mission

    def warn(self, mission: Reconfiguration) -> None:
        """Warn of a model that does not hold where the mission flies."""
        if self.chief is None:
            return
        if (doubtful := doubt(mission, self.chief.orbit, self.model.kind)) is not None:
            warnings.warn(doubtful, stacklevel=2)

    def to_toml(self) -> str:
        """The whole scenario; of files and fonts outside of it there is what they said."""
        axes = self.model.axes
        legs = []
        for leg, most in zip(self.leg, wanted(self.swarm, self.leg), strict=True):
            shape = leg.shape.portable(leg.targets or most, axes)
            joins = [
                join.model_copy(update={"start": portable(join.start, join.agents, axes)})
                for join in leg.join
            ]
            legs.append(leg.model_copy(update={"shape": shape, "join": joins}))
        start = portable(self.swarm.start, self.swarm.agents, axes)
        swarm = self.swarm.model_copy(update={"start": start})
        alone = self.model_copy(update={"leg": legs, "swarm": swarm})
        return tomli_w.dumps(alone.model_dump(exclude_none=True))
