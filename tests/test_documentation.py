"""Pages and names that must agree with the code: glossary, keys, docstrings, classes, tests."""

import re
import runpy
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGES = ("dynamics", "problems", "sato")
MEASURES = runpy.run_path(str(ROOT / "scripts/measure_code.py"))


def test_every_name_of_the_glossary_is_found_in_the_code():
    rows = re.findall(r"^\|(.+)\|$", (ROOT / "docs/glossary.md").read_text("utf-8"), flags=re.M)
    cells = [re.split(r"(?<!\\)\|", row)[-1] for row in rows if "---" not in row]
    names = {name for cell in cells for name in re.findall(r"`([^`]+)`", cell)}
    files = [file for package in PACKAGES for file in (ROOT / package).rglob("*.py")]
    words = set(re.findall(r"\w+", " ".join(file.read_text("utf-8") for file in files)))
    assert len(names) >= 60
    assert names - words == set()


def test_docstrings_name_a_thing_or_an_action():
    assert MEASURES["evasive_docstrings"]() == []


def test_public_classes_have_names_of_their_own():
    assert MEASURES["shared_class_names"]() == {}


def test_names_of_tests_have_at_most_70_characters():
    assert MEASURES["long_test_names"]() == []


def test_the_page_of_keys_is_current():
    page = runpy.run_path(str(ROOT / "scripts/write_scenario_keys.py"))["page"]()
    assert page == (ROOT / "docs/scenarios.md").read_text(encoding="utf-8")
