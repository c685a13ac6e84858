"""Pages and names that must agree with the code: glossary, keys, docstrings, classes, tests."""

import re
import runpy
from pathlib import Path

from public_docstrings import all_faults, function_faults

import sato

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


def test_the_reference_lists_every_public_name_of_sato():
    page = (ROOT / "docs/reference.md").read_text("utf-8")
    assert set(sato.__all__) - set(re.findall(r"^   (\w+)$", page, flags=re.M)) == set()


def test_public_docstrings_tell_parameters_units_shapes_and_errors():
    assert all_faults() == []


def test_docstrings_without_units_or_errors_are_noticed():
    def careless(length: float) -> float:
        """Return it.

        Args:
            length: Size of it.
        """
        raise ValueError(length)

    assert list(function_faults(careless)) == [
        "careless: no unit of length",
        "careless: no unit of what is returned",
        "careless: raises ValueError",
    ]


def test_public_classes_have_names_of_their_own():
    assert MEASURES["shared_class_names"]() == {}


def test_names_of_tests_have_at_most_70_characters():
    assert MEASURES["long_test_names"]() == []


def test_architecture_lists_the_modules_entered_before_the_loop():
    page = (ROOT / "docs/architecture.md").read_text("utf-8")
    rows = re.findall(r"^\| `((?:dynamics|problems|sato)[\w.]*)` \| (`.*`) \|$", page, flags=re.M)
    listed = {
        f"{package.replace('.', '/')}/{name}.py"
        for package, names in rows
        for name in re.findall(r"`(\w+)`", names)
    }
    assert listed == set(MEASURES["modules_of_a_mission"]()[0])
    assert f"Python enters {len(listed)} modules" in page


def test_the_page_of_keys_is_current():
    page = runpy.run_path(str(ROOT / "scripts/write_scenario_keys.py"))["page"]()
    assert page == (ROOT / "docs/scenarios.md").read_text(encoding="utf-8")
