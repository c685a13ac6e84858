"""Pages that must agree with the code: glossary and keys."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGES = ("dynamics", "problems", "sato")


def test_every_name_of_the_glossary_is_found_in_the_code():
    rows = re.findall(r"^\|(.+)\|$", (ROOT / "docs/glossary.md").read_text("utf-8"), flags=re.M)
    cells = [re.split(r"(?<!\\)\|", row)[-1] for row in rows if "---" not in row]
    names = {name for cell in cells for name in re.findall(r"`([^`]+)`", cell)}
    files = [file for package in PACKAGES for file in (ROOT / package).rglob("*.py")]
    words = set(re.findall(r"\w+", " ".join(file.read_text("utf-8") for file in files)))
    assert len(names) >= 60
    assert names - words == set()
