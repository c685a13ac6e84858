"""Origin of a run's scenario: a built-in one, a file or Python, and the overrides."""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Literal, NamedTuple

from pydantic import TypeAdapter

from sato.scenario.errors import ScenarioError
from sato.scenario.file import parse_embedded, read, scenarios, spell_out
from sato.scenario.overrides import Setting


class Origin(NamedTuple):
    """Source of a scenario, and what was changed in it."""

    kind: Literal["built-in", "file", "python"]
    name: str = ""  # of the built-in scenario, or of the file
    overrides: tuple[str, ...] = ()  # "table.key = value", each with all its tables

    @classmethod
    def of(cls, scenario: object, overrides: Iterable[Setting]) -> "Origin":
        """Return the origin of a scenario that can be read with these overrides."""
        if not isinstance(scenario, str | Path):
            return cls("python")
        settings = spell_out(scenario, overrides)
        if str(scenario) in scenarios():
            return cls("built-in", str(scenario), settings)
        return cls("file", Path(scenario).name, settings)

    @classmethod
    def from_json(cls, text: str) -> "Origin":
        """Read what `to_json` wrote; a `ValueError` refuses anything else."""
        found: Origin = TypeAdapter(cls).validate_json(text)
        return found

    def to_json(self) -> str:
        """Write the origin for the attributes of a run file."""
        return json.dumps(self._asdict())

    def __str__(self) -> str:
        """Describe the scenario: "random with swarm.agents = 500"."""
        if self.kind == "python":
            return "a mission from Python"
        source = f"the file {self.name}" if self.kind == "file" else self.name
        return " with ".join(filter(None, [source, ", ".join(self.overrides)]))

    def gives(self, text: str) -> bool:
        """Tell whether it gives this scenario; a file or Python may give any."""
        if self.kind != "built-in":
            return True
        try:
            told = read(self.name, self.overrides).to_toml()
            # Versions before a key was known did not write it.
            return text == told or parse_embedded(text).to_toml() == told
        except ScenarioError:
            return False
