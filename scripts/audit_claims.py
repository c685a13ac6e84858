"""Audit of the claims of README, docs and lessons: python scripts/audit_claims.py.

A claim is a sentence, a row of prose in a table, or a table of numbers, with a word of generality
or a number. Claims are found in the pages; docs/claims.toml says for each what shows it. The audit
fails on a claim without an entry, on an entry whose claim is gone, and on evidence that does not
exist. Blocks of code and formulas are no claims, nor is a block that a script writes:

    <!-- written by scripts/benchmark_costs.py -->
    …
    <!-- end -->

An entry is a line, `"key opening words" = "evidence; evidence"`. The key is a hash of the sentence,
so a sentence that changes needs another look, and one that is only wrapped otherwise does not.
Evidence is one of

    tests/test_x.py::test_law     a test that fails if the claim is false
    campaigns/x.toml, scripts/x.py   what measures the number, or the table
    sato run orbit, sato compare  a command whose output says it: of a built-in scenario, if a run
    sato/x.py::name               the line of code that makes it so
    docs/safety.md#proof          a proof, or a table of the pages that says it
    [Morgan2016]                  a statement of a work of the bibliography
    inline                        the sentence itself names its test, script, campaign or file
    page                          scripts of this page or lesson, which a test runs
    definition                    no claim: what a word or symbol means, an assumption, what is not
                                  promised, or what to do
    arithmetic                    follows from numbers that stand beside it
    unrepeated                    measured once; no script of the repository repeats it

`definition` does not do for strong words (never, always, guaranteed, …). After changing pages, or
merging: `python scripts/audit_claims.py --new` prints lines for the claims without an entry; those
that replace a similar sentence have its evidence, to be judged again. Read each against the
code, mend the page where it says too much, put the lines under the heading of the page, and delete
the entries that are named as gone. `--write` does the last two, and marks new lines with `?`, which
the audit refuses until somebody has decided.
"""

import argparse
import re
import sys
import tomllib
from collections import Counter
from collections.abc import Iterator
from difflib import get_close_matches
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
LIST = ROOT / "docs/claims.toml"
NOT_CLAIMS = {"scenarios.md", "bibliography.md"}  # the first is written by a script
GENERAL = re.compile(
    r"\b(no|none|never|nobody|nothing|nowhere|neither|ever|every\w*|any\w*|all|always|only|each|"
    r"whatever|whenever|whichever|whoever|guarantee\w*|proven|impossible)\b",
    re.IGNORECASE,
)
STRONG = re.compile(
    r"\b(never|nobody|ever|always|whatever|whenever|guarantee[ds]?|impossible)\b", re.IGNORECASE
)
NUMBER = re.compile(r"(?<![\w.−-])\d")
NO_CLAIM = re.compile(  # text in which a number numbers, names or cites
    r"`[^`]*`|\$[^$]*\$|\[[A-Z][^\]]*\d{4}[^\]]*\]|\((\d+)\)(–\((\d+)\))?|\b\d-(D|norm)\b"
    r"|\bPython 3\.\d+"
    r"|\b(Figs?|Tables?|eqs?|Eqs?|Secs?|lines?|l|Methods?|Problems?|Propositions?|Theorems?|Lemmas?|"
    r"Remarks?|Claims?|[Ll]essons?|Algorithms?|[Aa]ssumptions?|[Rr]ules?|[Cc]ase|Footnote)\.? "
    r"[\dIVX]+[a-z]?((–|, | and )[\dIVX]+)*"
)
TABLE_OF_PROSE = 12  # words a row, on average
CLASSES = {"inline", "page", "definition", "arithmetic", "unrepeated"}
NAMED = re.compile(r"\b((?:tests|campaigns|scripts|docs|sato|problems|dynamics)/[\w/.-]+\.\w+)")


class Claim(NamedTuple):
    """Sentence, row or table that says something general, or a number."""

    page: str
    text: str

    @property
    def key(self) -> str:
        """Hash and first words, without the targets of links."""
        words = re.sub(r"⟨[^⟩]*⟩", "", self.text)
        opening = " ".join(re.sub(r"[^\w .,()/%–-]", "", words)[:60].split())
        return f"{sha256(words.encode()).hexdigest()[:8]} {opening}"


def pages() -> list[Path]:
    """List README, the pages of docs whose text is written by hand, and the lessons."""
    docs = [file for file in sorted((ROOT / "docs").glob("*.md")) if file.name not in NOT_CLAIMS]
    lessons = [ROOT / "docs/lessons/index.md", *sorted((ROOT / "docs/lessons").glob("*.py"))]
    return [ROOT / "README.md", *docs, *lessons]


def read_page(page: Path) -> str:
    """Return the text of a page; of a lesson, its cells of text."""
    text = page.read_text("utf-8")
    if page.suffix == ".py":
        cells = re.findall(r"^# %% \[markdown\]\n(.*?)(?=^# %%|\Z)", text, flags=re.M | re.S)
        text = "\n\n".join(re.sub(r"^# ?", "", cell, flags=re.M) for cell in cells)
    return text


def strip(text: str) -> str:
    """Take away code, formulas and what scripts write; links keep their words."""
    text = re.sub(r"<!-- written by .*?<!-- end -->", "\n", text, flags=re.DOTALL)
    text = re.sub(r"^(```+|~~~+|:::+).*?^\1", "\n", text, flags=re.MULTILINE | re.DOTALL)
    text = re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)
    text = re.sub(r"(?<=\n\n)(?: {4}[^\n]*\n)+", "\n", text)
    text = re.sub(r"\$\$.*?\$\$", "", text, flags=re.DOTALL)
    text = re.sub(r"^#.*$|^\[\w+\]:.*$", "\n", text, flags=re.MULTILINE)
    text = re.sub(r"!\[[^\]]*\]\([^)]*\)", "", text)
    return re.sub(r"\[([^\]]+)\]\(([^)]*)\)", r"\1⟨\2⟩", text)


def sentences(block: str) -> Iterator[str]:
    """Split a paragraph."""
    block = re.sub(r"\*\*|(?<!\w)\*(?=\S)|(?<=\S)\*(?!\w)", "", block)
    block = " ".join(re.sub(r"^\s*(?:[-*]|\d+\.|>)\s+", "", block).split())
    ends = (
        r"(?<=[.!?])(?<!Fig\.)(?<!Figs\.)(?<!eq\.)(?<!Eq\.)(?<!Sec\.)(?<! l\.)(?<!vs\.)[)”\"]*\s+"
    )
    yield from filter(None, re.split(ends + r"(?=[\[(“\"`]*[A-Z0-9λΔψ`])", block))


def tables(lines: list[str]) -> Iterator[str]:
    """Give rows of prose, or a table of numbers as a whole."""
    rows = [
        " | ".join(cell.strip().replace("**", "") for cell in re.split(r"(?<!\\)\|", line)[1:-1])
        for line in lines
        if not re.fullmatch(r"[|\s:-]+", line)
    ]
    words = len(re.findall(r"[^\W\d]{2,}", re.sub(r"⟨[^⟩]*⟩", "", " ".join(rows[1:]))))
    if words > TABLE_OF_PROSE * len(rows[1:]):
        yield from rows[1:]
    else:
        yield "table " + " ¦ ".join(rows)


def units(text: str) -> Iterator[str]:
    """Give sentences, rows and tables of a page."""
    for block in re.split(r"\n\s*\n|\n(?=\s*(?:[-*]|\d+\.) )", strip(text)):
        for is_table, part in _parts(block):
            yield from tables(part) if is_table else sentences("\n".join(part))


def _parts(block: str) -> Iterator[tuple[bool, list[str]]]:
    lines = [line.strip() for line in block.splitlines() if line.strip()]
    while lines:
        is_table = lines[0].startswith("|")
        end = next((i for i, line in enumerate(lines) if line.startswith("|") != is_table), None)
        yield is_table, lines[:end]
        lines = lines[end:] if end else []


def is_claim(text: str) -> bool:
    """Tell whether a sentence has a word of generality or a number."""
    plain = NO_CLAIM.sub(" ", re.sub(r"⟨[^⟩]*⟩", "", text))
    return bool(GENERAL.search(plain) or NUMBER.search(plain))


def find_claims() -> list[Claim]:
    """Return the claims of all pages, in order."""
    found = {
        Claim(str(page.relative_to(ROOT)), unit): None
        for page in pages()
        for unit in units(read_page(page))
        if is_claim(unit)
    }
    return list(found)


@cache
def _text(path: str) -> str:
    file = ROOT / path
    return file.read_text("utf-8") if file.is_file() else ""


def _anchors(path: str) -> set[str]:
    headings = re.findall(r"^#+ +(.*?) *$", _text(path), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def is_there(evidence: str, claim: Claim) -> bool:
    """Tell whether evidence exists, and may stand for this claim."""
    plain = NO_CLAIM.sub(" ", claim.text)
    if evidence == "definition":
        return not STRONG.search(plain)
    if evidence == "inline":
        named = NAMED.findall(claim.text.replace("../", ""))
        named += [f"docs/{name}" for name in re.findall(r"⟨(\w[\w-]+\.md)", claim.text)]
        other = re.findall(r"`(test_\w+|sato [^`]+)`", claim.text)
        return bool(named or other) and all((ROOT / path).exists() for path in named)
    if evidence == "page":
        return claim.page.endswith(".py") or bool(re.search("```(python|sh)", _text(claim.page)))
    if evidence in CLASSES:
        return True
    if evidence.startswith("["):
        return f"- {evidence}" in _text("docs/bibliography.md")
    if flown := re.match(r"sato run (\w+)", evidence):
        return bool(_text(f"sato/scenarios/{flown[1]}.toml"))
    if evidence.startswith("sato "):
        return f'"{evidence.split()[1]}"' in _text("sato/cli.py").replace("def ", '"').replace(
            "(", '"'
        )
    path, separator, name = evidence.partition("::" if "::" in evidence else "#")
    if separator == "#":
        return name in _anchors(path)
    if separator:
        head = rf"^\s*(?:async def|def|class) {name}\b|^\s*[\"']?{name}[\"']?\s*[:=]"
        return re.search(head, _text(path), flags=re.MULTILINE) is not None
    return bool(NAMED.fullmatch(path) or path in ("Makefile", "pyproject.toml")) and bool(
        (ROOT / path).is_file()
    )


def read_list() -> dict[str, dict[str, str]]:
    """Return the evidence by page and key."""
    return tomllib.loads(LIST.read_text("utf-8")) if LIST.exists() else {}


def faults(claims: list[Claim], listed: dict[str, dict[str, str]]) -> list[str]:
    """Say what the list lacks, has too much, or shows by what does not exist."""
    said = []
    for claim in claims:
        evidence = listed.get(claim.page, {}).get(claim.key)
        if evidence is None:
            said.append(f"{claim.page}: not listed: {claim.text}")
            continue
        for one in evidence.split("; "):
            if not is_there(one, claim):
                said.append(f"{claim.page}: {one!r} does not show: {claim.text}")
    keys = {(claim.page, claim.key) for claim in claims}
    for page, entries in listed.items():
        said += [f"{page}: gone: {key}" for key in entries if (page, key) not in keys]
    return said


def _former(claim: Claim, gone: dict[str, str]) -> str:
    """Return the evidence of the entry that a claim seems to replace."""
    openings = {key.split(" ", 1)[-1]: evidence for key, evidence in gone.items()}
    near = get_close_matches(claim.key.split(" ", 1)[-1], list(openings), 1, 0.6)
    return openings[near[0]] + "; ?" if near else "?"


def update(claims: list[Claim], listed: dict[str, dict[str, str]]) -> dict[str, dict[str, str]]:
    """Return the list in the order of the pages, without what is gone, and with new lines."""
    result: dict[str, dict[str, str]] = {}
    for page in dict.fromkeys(claim.page for claim in claims):
        here = [claim for claim in claims if claim.page == page]
        before = listed.get(page, {})
        keys = {claim.key for claim in here}
        gone = {key: evidence for key, evidence in before.items() if key not in keys}
        result[page] = {c.key: before.get(c.key) or _former(c, gone) for c in here}
    return result


def as_toml(entries: dict[str, dict[str, str]]) -> str:
    """Return the text of the list."""
    head = "# What shows each claim of the pages: see scripts/audit_claims.py.\n"
    parts = [head]
    for page, lines in entries.items():
        parts.append(f'\n["{page}"]\n')
        parts += [f'"{key}" = "{evidence}"\n' for key, evidence in lines.items()]
    return "".join(parts)


def kind_of(evidence: str) -> str:
    """Return the class of an evidence."""
    if evidence in CLASSES:
        return evidence
    if evidence.startswith("["):
        return "paper"
    if evidence.startswith("sato "):
        return "command"
    folder = evidence.split("/")[0]
    return {"docs": "proof or table", "tests": "test"}.get(folder, folder)


def main() -> int:
    """Audit, or print what is new."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--new", action="store_true", help="print lines for claims without one")
    parser.add_argument("--write", action="store_true", help="put them into the list, and tidy it")
    parser.add_argument("--count", action="store_true", help="count claims by what shows them")
    given = parser.parse_args()
    claims, listed = find_claims(), read_list()
    if given.write:
        LIST.write_text(as_toml(update(claims, listed)), "utf-8")
        return 0
    if given.new:
        for page, lines in update(claims, listed).items():
            for claim in (c for c in claims if c.page == page):
                if claim.key not in listed.get(page, {}):
                    print(f'# {page}: {claim.text}\n"{claim.key}" = "{lines[claim.key]}"')
        return 0
    said = faults(claims, listed)
    print("\n".join(said))
    if given.count:
        shown = (e for lines in listed.values() for e in lines.values())
        for kind, count in Counter(kind_of(e.split("; ")[0]) for e in shown).most_common():
            print(f"{count:5} {kind}")
    print(f"{len(claims)} claims, {len(said)} faults")
    return bool(said)


if __name__ == "__main__":
    sys.exit(main())
