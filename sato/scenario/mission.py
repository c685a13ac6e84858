"""Base of the definitions of whole missions."""

from abc import abstractmethod
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import numpy as np
import tomli_w
from pydantic import Field

from sato.scenario.definition import Definition, In
from sato.scenario.table import write_table

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")]


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Mission(Definition):
    """Mission of a system: a scenario, from Python or from a file."""

    system: ClassVar[str]

    name: Annotated[Name, In(""), "name of the scenario"] = "mission"

    @classmethod
    def with_defaults(cls, data: dict[str, Any]) -> dict[str, Any]:
        """Return the tables of a file, with defaults that depend on other keys filled in."""
        return data

    @abstractmethod
    def draw(self, rng: np.random.Generator) -> "Mission":
        """Return the mission with every random draw made and every "auto" replaced by a number.

        The same state of the generator gives the same mission; a drawn mission stays as it is.

        Args:
            rng: Draws starts, formations, obstacles and parameters.

        Raises:
            InputError: The mission cannot be flown.
        """

    @abstractmethod
    def warnings(self) -> list[str]:
        """List doubts about a drawn mission, a sentence each."""

    @abstractmethod
    def without_files(self) -> "Mission":
        """Return the same mission with the contents of files and fonts in place of their names."""

    def to_toml(self) -> str:
        """Write the mission as a scenario file that needs no other file."""
        return tomli_w.dumps({"system": self.system} | write_table(self.without_files()))
