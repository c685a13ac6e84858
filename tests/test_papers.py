"""Map of the papers: all that is numbered in them is there, with commands and tests that exist."""

import re
import shlex
from pathlib import Path

import pytest
import typer.main
from click import Context

import sato
from sato.cli import app
from sato.shapes.formation_library import formation_names

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs/papers.md").read_text("utf-8")
PAPERS = ROOT.parent / "shared/papers"
ROMAN = {"I": 1, "II": 2, "III": 3}
# How many of each the papers number. The statements of [Morgan2016] share their numbers.
COUNTS = {
    "Morgan2016": {
        "equation": 69, "Fig.": 6, "Table": 0, "Method": 3, "Problem": 7, "statement": 9,
        "Remark": 5, "Claim": 1, "Definition": 1,
    },
    "Lusk2020": {
        "equation": 18, "Fig.": 7, "Table": 3, "Method": 0, "Problem": 0, "statement": 1,
        "Remark": 0, "Claim": 0, "Definition": 0,
    },
    "Bernard2023": {
        "equation": 30, "Fig.": 7, "Table": 1, "Method": 0, "Problem": 0, "statement": 0,
        "Remark": 1, "Claim": 0, "Definition": 0,
    },
}  # fmt: skip
STATEMENTS = "Proposition|Theorem|Lemma|Corollary"
SPAN = re.compile(r"\((\d+)\)(?:–\((\d+)\))?")
TITLES = {
    "Morgan2016": "Swarm Assignment and Trajectory Optimization",
    "Lusk2020": "A Distributed Pipeline for Scalable",
    "Bernard2023": "Decentralized Connectivity Maintenance",
}
HEADS = {  # of numbers in the texts; those of equations are tags, or stand after the formula
    "equation": r"\((\d+)\)\s*\$\$|\\tag\{(\d+)\}|\$\$\s*\((\d+)\)",
    "Fig.": r"^(?:\*\*)?Fig(?:ure|\.) (\d+)\.",
    "Table": r"^ ?TABLE ([IV]+)\b",
    "Method": r"\bMethod (\d+)\b",
}


def rows(paper: str) -> list[list[str]]:
    """Return the cells of all rows about a paper."""
    part = re.split(r"^## ", PAGE, flags=re.M)
    (own,) = (text for text in part if text.startswith(f"[{paper}]"))
    lines = re.findall(r"^\|.*\|$", own, flags=re.M)
    cells = [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines]
    return [row for row in cells if "---" not in row[0] and row[1] != "content"]


def mapped(paper: str) -> dict[str, list[int]]:
    """Return the numbers that the page has of each kind."""
    found: dict[str, list[int]] = {kind: [] for kind in COUNTS[paper]}
    for name in (row[0] for row in rows(paper)):
        if span := SPAN.fullmatch(name):
            found["equation"] += range(int(span[1]), int(span[2] or span[1]) + 1)
        elif numbered := re.fullmatch(r"([A-Z][a-z]+\.?) (\d+|I+)(?:[a-f]\b.*)?", name):
            kind = "statement" if re.fullmatch(STATEMENTS, numbered[1]) else numbered[1]
            found[kind].append(ROMAN.get(numbered[2]) or int(numbered[2]))
    return found


@pytest.mark.parametrize("paper", COUNTS)
def test_every_number_of_a_paper_is_on_the_map(paper):
    for kind, numbers in mapped(paper).items():
        expected = list(range(1, COUNTS[paper][kind] + 1))
        assert sorted(set(numbers)) == expected, kind
        assert kind != "equation" or numbers == expected  # in order, none twice


@pytest.mark.skipif(not PAPERS.is_dir(), reason="the texts of the papers are not at hand")
@pytest.mark.parametrize("paper", COUNTS)
def test_the_papers_number_as_many_as_is_said(paper):
    texts = [file.read_text("utf-8") for file in PAPERS.glob("*.txt")]
    (text,) = (text for text in texts if TITLES[paper] in text[:2000])
    for kind, expected in COUNTS[paper].items():
        name = STATEMENTS if kind == "statement" else kind
        head = rf"^(?:\*\*(?:{name}) (\d+)\.?\*\*|(?:{name}) (\d+)\. )"
        found = re.findall(HEADS.get(kind, head), text, flags=re.M)
        words = {next(filter(None, each)) if isinstance(each, tuple) else each for each in found}
        numbers = {ROMAN.get(word) or int(word) for word in words}
        assert numbers == set(range(1, expected + 1)), kind


def commands() -> list[str]:
    """Return all commands of the map."""
    return sorted(set(re.findall(r"`(sato [^`]+)`", PAGE)) - {"sato check", "sato plot"})


@pytest.mark.parametrize("command", commands())
def test_commands_of_the_map_are_valid(command):
    words = shlex.split(command)[1:]
    group = typer.main.get_command(app)
    context = Context(group, info_name="sato")
    while hasattr(group, "resolve_command"):
        name, group, words = group.resolve_command(context, words)
        context = Context(group, info_name=name, parent=context)
    given = group.make_context(name, words, parent=context.parent).params
    if name in ("run", "show") and "scenario" in given:
        sato.read(given["scenario"], given.get("override") or ())
        assert given["scenario"] in sato.scenarios()
    elif name == "gains":
        listed = {each.rpartition("/")[2].lower() for each in formation_names()}
        assert given["formation"].rpartition("/")[2].lower() in listed
    elif name == "run":
        assert (ROOT / given["file"]).is_file()
    elif "folder" in given:
        assert re.fullmatch(rf"runs/({'|'.join(sato.scenarios())})-0", str(given["folder"]))


def test_tests_of_the_map_exist():
    named = re.findall(r"\[(\w+): ([\w ]+)\]\(\.\./tests/test_(\w+)\.py\)", PAGE)
    assert len(named) == len(re.findall(r"\]\(\.\./tests/", PAGE)) > 100
    for file, law, link in named:
        assert file == link
        text = (ROOT / f"tests/test_{file}.py").read_text("utf-8")
        assert f"\ndef test_{law.replace(' ', '_')}(" in text, (file, law)


def test_every_row_of_the_map_has_a_verdict():
    for paper in COUNTS:
        for row in rows(paper):
            assert re.match(r"reproduced|corrected|surpassed|not applicable", row[2]), row


def test_rows_that_no_run_shows_name_their_own_tests():
    """Propositions and proofs are shown by tests or scripts, not by a flight."""
    for paper in COUNTS:
        for row in rows(paper):
            for file in re.findall(r"`pytest tests/(test_\w+\.py)`", row[3]):
                assert f"../tests/{file})" in row[4], row
            is_statement = re.match(rf"(?:{STATEMENTS}) |\((?:3|4|5)\d\)", row[0])
            if paper == "Morgan2016" and is_statement and row[0] != "Proposition 9":
                assert not row[3].startswith("`sato run"), row
