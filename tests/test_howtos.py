"""How-to pages: their scripts run in an empty folder and print what the pages show."""

import re
from contextlib import redirect_stdout
from io import StringIO
from itertools import pairwise
from pathlib import Path

import pytest

PAGES = sorted((Path(__file__).parents[1] / "docs").glob("howto-*.md"))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_scripts_of_a_page_print_the_block_that_follows(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"^```(\w*)\n(.*?)^```", page.read_text("utf-8"), flags=re.M | re.S)
    assert any(language == "python" for language, _ in blocks)
    names = {"__name__": "howto"}
    for (language, code), (next_language, following) in pairwise([*blocks, ("end", "")]):
        if language == "python":
            with redirect_stdout(StringIO()) as printed:
                exec(compile(code, page.name, "exec"), names)
            shown = following if next_language in ("", "text") else ""
            assert printed.getvalue() == shown
