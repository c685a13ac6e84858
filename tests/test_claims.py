"""Claims of the pages: each is listed with what shows it; tables name what writes them."""

import re
import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
AUDIT = runpy.run_path(str(ROOT / "scripts/audit_claims.py"))
BENCHMARKS = (ROOT / "docs/benchmarks.md").read_text("utf-8")
MARKED = re.compile(r"<!-- (written by|copied from) (.*?) -->\n(.*?)<!-- end -->", re.DOTALL)
COPIED = {  # before scripts wrote them; none may be added
    "campaigns/missions.toml",
    "campaigns/forest.toml, campaigns/wrecks.toml",
    "campaigns/uiuc.toml",
    "scripts/benchmark.py",
}


def test_every_claim_of_the_pages_is_listed_with_what_shows_it():
    assert AUDIT["faults"](AUDIT["find_claims"](), AUDIT["read_list"]()) == []


def test_few_claims_are_of_numbers_that_nothing_repeats():
    listed = AUDIT["read_list"]().values()
    unrepeated = [key for lines in listed for key, shown in lines.items() if "unrepeated" in shown]
    assert len(unrepeated) <= 45  # may only become fewer


def audited(text: str, evidence: dict[str, str]) -> list[str]:
    claims = [AUDIT["Claim"]("docs/limits.md", unit) for unit in AUDIT["units"](text)]
    claims = [claim for claim in claims if AUDIT["is_claim"](claim.text)]
    keys = {claim.key.split(" ", 1)[1]: claim.key for claim in claims}
    listed = {keys.get(opening, opening): shown for opening, shown in evidence.items()}
    return [said.split(": ")[1] for said in AUDIT["faults"](claims, {"docs/limits.md": listed})]


@pytest.mark.parametrize(
    "evidence",
    [
        "sato/export.py::export_oem",
        "tests/test_papers.py::test_nothing",
        "docs/safety.md#luck",
        "campaigns/none.toml",
        "[Nobody2026]",
        "sato run nothing",
        "inline",
        "?",
    ],
)
def test_evidence_that_does_not_exist_shows_nothing(evidence):
    shown = audited("Vehicles fly. No two meet.", {"No two meet.": evidence})
    assert shown == [f"{evidence!r} does not show"]


@pytest.mark.parametrize(
    "evidence",
    [
        "docs/safety.md#proof",
        "tests/test_papers.py::test_tests_of_the_map_exist",
        "campaigns/uiuc.toml",
        "[Morgan2016]",
        "sato run orbit",
        "sato/reconfiguration/commitment.py::improve; arithmetic",
    ],
)
def test_evidence_that_exists_is_accepted(evidence):
    assert audited("Vehicles fly. No two meet.", {"No two meet.": evidence}) == []


def test_claims_that_are_new_and_entries_that_are_gone_are_found():
    assert audited("No two meet.", {}) == ["not listed"]
    assert audited("Two meet.", {"0 No two meet.": "page"}) == ["gone"]


def test_strong_words_are_no_definitions():
    shown = "'definition' does not show"
    assert audited("They never meet.", {"They never meet.": "definition"}) == [shown]
    assert audited("Each has one.", {"Each has one.": "definition"}) == []


def test_audit_reads_sentences_and_tables_and_no_code():
    text = (
        "See [all](x.md), Fig. 3 and `any` code.\nIt takes 5 s; see eq. 7. Then `x = 1`.\n\n"
        "```\nnever 5\n```\n\n- **No** list\n  is left out.\n\n    x = 5, a formula\n\n"
        "| a | b |\n|---|---|\n| x | 1 |\n| y | 2 |\n\n"
        "<!-- written by scripts/benchmark.py -->\n| never | 9 |\n<!-- end -->\n"
    )
    found = [unit for unit in AUDIT["units"]("\n\n" + text) if AUDIT["is_claim"](unit)]
    assert found == [
        "See all⟨x.md⟩, Fig. 3 and `any` code.",
        "It takes 5 s; see eq. 7.",
        "No list is left out.",
        "table a | b ¦ x | 1 ¦ y | 2",
    ]


def test_list_of_claims_is_in_the_order_of_the_pages_and_tidy():
    text = AUDIT["as_toml"](AUDIT["update"](AUDIT["find_claims"](), AUDIT["read_list"]()))
    assert text == (ROOT / "docs/claims.toml").read_text("utf-8")


def test_sentence_that_replaces_another_has_its_evidence_to_be_judged():
    claim = AUDIT["Claim"]("README.md", "All of the 5 vehicles arrive in time, and without slack.")
    before = AUDIT["Claim"]("README.md", "All of the 4 vehicles arrive in time, and without slack.")
    listed = {"README.md": {before.key: "campaigns/uiuc.toml"}}
    shown = AUDIT["update"]([claim], listed)
    assert shown == {"README.md": {claim.key: "campaigns/uiuc.toml; ?"}}


def test_tables_of_benchmarks_name_what_writes_them():
    assert not re.search(r"^\|", MARKED.sub("", BENCHMARKS), flags=re.MULTILINE)
    for how, source, table in MARKED.findall(BENCHMARKS):
        assert how == "written by" or source in COPIED
        for path in re.findall(r"[\w/-]+\.(?:py|toml)", source):
            assert (ROOT / path).is_file()
        if how == "written by":
            assert re.search(r"^\*Commit [0-9a-f]{7,}.*Python 3", table, flags=re.MULTILINE), source
