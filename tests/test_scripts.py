"""Scripts: every one imports, and says what it does."""

import ast
import runpy
from pathlib import Path

import pytest

SCRIPTS = sorted((Path(__file__).parents[1] / "scripts").glob("*.py"))


@pytest.mark.parametrize("path", SCRIPTS, ids=[path.stem for path in SCRIPTS])
def test_script_imports_and_has_a_docstring(path, monkeypatch):
    monkeypatch.syspath_prepend(path.parent)
    assert ast.get_docstring(ast.parse(path.read_text(encoding="utf-8")))
    runpy.run_path(str(path), run_name="imported")
