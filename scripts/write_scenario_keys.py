"""Write the page of all keys of scenario files: python scripts/write_scenario_keys.py."""

from pathlib import Path

from sato.keys import format_keys
from sato.systems import SYSTEMS

PAGE = Path(__file__).parents[1] / "docs" / "scenarios.md"
HEAD = """# Keys of scenario files

A scenario is a TOML file; `sato show NAME` prints one with all defaults. A number with a unit has
the unit at the end of its key. Any unit of the same kind is accepted and converted to SI: `_m _km
_cm _mm`, `_s _ms _min _h`, `_m_s _km_s _km_h _cm_s _mm_s`, `_m_s2 _cm_s2 _mm_s2`, `_rad _deg`,
`_rad_s _deg_s`, `_hz`, `_m3_s2 _km3_s2`. `--set table.key=value`
changes a key; where only one table has the key, the key alone is enough. `--set table.key=none`
takes a key away, so that it has its default; in Python `"table.key=none"` or `("table.key", None)`
does. Of a key that has a value `"none"`, as `assignment.kind` of formations, `none` is that value;
in quotes, `--set 'name="none"'`, it is a text.

This page is generated from the definitions of the missions; `sato keys SYSTEM` prints the same.
"""


def page() -> str:
    """Return the page: a block of keys for every system."""
    blocks = [f"## {name.capitalize()}\n\n```\n{format_keys(name)}```\n" for name in SYSTEMS]
    return "\n".join([HEAD, *blocks])


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
