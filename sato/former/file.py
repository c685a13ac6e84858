"""What the scenario files of all systems have in common."""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated, Any

import numpy as np
from pydantic import Field, PrivateAttr

from sato.former.refusal import Refusal, ScenarioError
from sato.former.units import Table


class ScenarioFile(Table, ABC):
    """A scenario as it stands in a file; that of a system narrows `system` to its own name."""

    system: str
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")]

    _source: str = PrivateAttr(default="scenario")  # in messages: where it was read from

    def model_post_init(self, context: Any) -> None:
        """Remember the name of the file."""
        if isinstance(context, dict):
            self._source = context.get("source", self._source)

    @abstractmethod
    def build(self, rng: np.random.Generator) -> Any:
        """The mission, with everything drawn that is left to chance.

        Args:
            rng: Draws all of it; the same state gives the same mission.

        Raises:
            ScenarioError: What is asked for cannot be.
        """

    @abstractmethod
    def warn(self, mission: Any) -> None:
        """Warn of what is doubtful about a mission.

        Apart from `build`, for a mission is built again whenever its run is judged.

        Args:
            mission: What `build` made of this.
        """

    @abstractmethod
    def to_toml(self) -> str:
        """The whole scenario, so that it can be repeated from this text alone."""

    @contextmanager
    def building(self) -> Iterator[None]:
        """What is refused in here is a `ScenarioError` that names the file."""
        try:
            yield
        except Refusal as refusal:
            raise ScenarioError(f"{self._source}: {refusal}") from refusal
