"""Pages: scripts print what the pages show, commands run, links lead to files and headings."""

import re
import shlex
from contextlib import redirect_stdout
from io import StringIO
from itertools import pairwise
from pathlib import Path
from unittest.mock import patch

import pytest
from test_cli import call
from typer.main import get_command

import sato
from problems.solvers import load_adapters
from sato.cli import app
from sato.systems import SYSTEMS

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted(DOCS.glob("**/*.md"))]
PAGES = [page for page in PAGES if not {"_build", "generated"} & set(page.parts)]
TEXTS = {page: page.read_text("utf-8") for page in PAGES}
FRAGMENTS = {"architecture", "campaigns"}  # parts of files, some of them for a cluster
BLOCK = re.compile(r"^```([^\n]*)\n(.*?)^```", flags=re.M | re.S)
SCRIPTS = [
    page
    for page in sorted(DOCS.glob("*.md"))
    if "\n```python" in TEXTS[page] and page.stem not in FRAGMENTS
]


@patch.dict(SYSTEMS)
@patch.dict(load_adapters())
@pytest.mark.parametrize("page", SCRIPTS, ids=lambda page: page.stem)
def test_scripts_of_a_page_print_the_block_that_follows(page, tmp_path, monkeypatch):
    """Run scripts in an empty folder; one that begins with a name of a file is that file."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    names = {"__name__": "page"}
    for (language, code), (next_language, following) in pairwise(
        [*BLOCK.findall(TEXTS[page]), ("end", "")]
    ):
        file = re.match(r"# (\w+\.(py|toml))\n", code)
        if file:
            (tmp_path / file[1]).write_text(code, "utf-8")
        elif language == "python":
            with redirect_stdout(StringIO()) as printed:
                exec(compile(code, page.name, "exec"), names)
            assert printed.getvalue() == (following if next_language in ("", "text") else "")
        elif language == "sh":
            for line in re.findall(r"^sato ([^#\n]*)", code, flags=re.M):
                done = call(*shlex.split(line))
                assert done.exit_code == 0, (line, done.output)


def _anchors(text: str) -> set[str]:
    headings = re.findall(r"^#+ +(.*?) *$", BLOCK.sub("", text), flags=re.M)
    words = [re.sub(r"[^\w\- ]", "", heading.lower()) for heading in headings]
    return {word.replace(" ", "-") for word in words}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_links_of_a_page_lead_to_files_and_headings(page):
    links = re.findall(r"\]\(([^)\s]+)\)", BLOCK.sub("", TEXTS[page]))
    dead = []
    for link in links:
        path, _, anchor = link.partition("#")
        if re.match(r"\w+:", link):
            continue
        target = (page.parent / path).resolve() if path else page
        if not target.exists() or (anchor and anchor not in _anchors(target.read_text("utf-8"))):
            dead.append(link)
    assert dead == []


def test_commands_of_pages_name_commands_and_keys_that_exist():
    known, count = set(get_command(app).commands), 0
    for page, text in TEXTS.items():
        if page.name == "CHANGELOG.md":
            continue
        blocks = "\n".join(code for _, code in BLOCK.findall(text)).replace("\\\n", "")
        lines = re.findall(r"^sato ([^#|>\n]+)", blocks, flags=re.M)
        for line in lines + re.findall(r"`sato ([^`\n]+)`", BLOCK.sub("", text)):
            words = shlex.split(line)
            assert words[0] in known or words[0].isupper() or not words[0].isalpha(), line
            if words[0] == "run" and set(words[1:2]) & sato.scenarios().keys():
                sato.read(words[1], [b for a, b in pairwise(words) if a == "--set"])
                count += 1
    assert count > 100


def test_files_and_tests_that_pages_name_exist():
    tests = " ".join(file.read_text("utf-8") for file in (ROOT / "tests").glob("*.py"))
    missing = set()
    for page in PAGES:
        if page.name == "CHANGELOG.md":  # speaks of what was there
            continue
        folders = "sato|problems|dynamics|scripts|tests|campaigns|docs"
        for path in re.findall(rf"(?<![\w/.])(?:{folders})/[\w/.-]+\.\w+", TEXTS[page]):
            if not (ROOT / path).exists():
                missing.add((page.name, path))
        for name in re.findall(r"`(test_\w+)`", TEXTS[page]):
            if f"def {name}(" not in tests:
                missing.add((page.name, name))
    assert missing == set()
