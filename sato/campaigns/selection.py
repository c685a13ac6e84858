"""Columns, conditions and groups of a campaign's runs, as they are typed."""

import re
from collections.abc import Sequence
from typing import Any, NamedTuple

from sato.campaigns.statistics import NAMES, Statistics, is_statistic
from sato.campaigns.table import EXITS, CampaignTable
from sato.scenario.errors import InputError, closest_name, join_names
from sato.scenario.errors import format_value as format_input
from sato.summary import format_value

GRAMMAR = "COLUMN or COLUMN/COLUMN, then =VALUE (or !=, <, <=, >, >=), then :STATISTIC"
_TERM = re.compile(
    r"(?P<column>[^/<>=!:]+)(?:/(?P<divisor>[^/<>=!:]+))?"
    r"(?:(?P<relation><=|>=|!=|=|<|>)(?P<value>[^:]*))?(?::(?P<statistic>\w+))?"
)
_SAME = {"=": "IN", "!=": "NOT IN"}
_EXITS = join_names(EXITS, "and")
Texts = Sequence[str]
# If nothing else is asked for, those of which the campaign has the columns.
DEFAULT_TERMS = {
    "exit=reached": ("exit",),
    "broken=[]": ("broken",),
    "min_separation_m:least": ("min_separation_m",),
    "fuel_m_s/fuel_lower_bound_m_s:median": ("fuel_m_s", "fuel_lower_bound_m_s"),
    "wall_s:median": ("wall_s",),
}


class Term(NamedTuple):
    """Expression of columns with the statistic that is shown of it."""

    label: str
    sql: str
    parameters: tuple[object, ...]
    is_rate: bool
    statistic: str

    @property
    def title(self) -> str:
        """Label with the statistic, for the head of a table."""
        return self.label if self.statistic == "rate" else f"{self.label}\n{self.statistic}"


class Group(NamedTuple):
    """Runs with the same values in the columns by which they are grouped."""

    key: tuple[object, ...]
    runs: int
    cells: tuple[Statistics, ...]  # one a term


class GroupTable(NamedTuple):
    """Statistics of terms for each group of runs."""

    by: tuple[str, ...]
    terms: tuple[Term, ...]
    groups: tuple[Group, ...]

    def text(self) -> tuple[list[str], list[list[str]]]:
        """Return the head and the rows, as text."""
        head = [*self.by, "runs", *(term.title for term in self.terms)]
        rows = []
        for key, runs, cells in self.groups:
            shown = zip(cells, self.terms, strict=True)
            texts = [cell.text(term.statistic) for cell, term in shown]
            rows.append([*map(format_value, key), str(runs), *texts])
        return head, rows

    def of(self, numbers: Sequence[int]) -> "GroupTable":
        """Return the table of some of the terms, by their numbers."""
        groups = [g._replace(cells=tuple(g.cells[n] for n in numbers)) for g in self.groups]
        return GroupTable(self.by, tuple(self.terms[n] for n in numbers), tuple(groups))


def name_group(key: Sequence[object]) -> str:
    """Name a group by its values."""
    return ", ".join(map(format_value, key)) or "all runs"


def parse_term(text: str, table: CampaignTable) -> Term:
    """Parse a column, a ratio of two, or a condition, with the statistic to show."""
    found = _TERM.fullmatch(text.strip())
    if not found:
        raise InputError("", f'"{text}" is not {GRAMMAR}')
    column, divisor, relation, value, statistic = found.groups()
    label, sql, is_rate = column, quote(column, table), column in table.booleans
    parameters: tuple[object, ...] = ()
    if divisor:
        label, is_rate = f"{column}/{divisor}", False
        sql = f"1.0 * {sql} / {quote(divisor, table)}"
    if relation:
        label, is_rate, parameters = f"{label} {relation} {value}", True, (_as_number(value),)
        if relation not in _SAME and isinstance(parameters[0], str):  # SQL has text above numbers
            raise InputError("", f'"{text}": {relation} needs a number, such as 0.5, got "{value}"')
        if column == "exit" and value not in EXITS:
            raise InputError("", f'"{text}": there is no exit "{value}"; there are {_EXITS}')
        if relation in _SAME:  # "30" may be a number, and the name of a case
            relation, parameters = _SAME[relation], (*parameters, value)
        sql = f"{sql} {relation} " + ("(?, ?)" if len(parameters) > 1 else "?")
    statistic = statistic or ("rate" if is_rate else "mean")
    if not is_statistic(statistic):
        close = closest_name(statistic, NAMES)
        hint = f'did you mean "{close}"' if close else f"there are {join_names(NAMES, 'and')}"
        raise InputError("", f'"{text}": unknown statistic "{statistic}"; {hint}, or p5 for 5 %?')
    if statistic == "rate" and not is_rate:
        hint = f"{label}>0 would count, and {label}:mean is a mean"
        raise InputError("", f'"{text}": {label} is neither true nor false; {hint}')
    return Term(label, sql, parameters, is_rate, statistic)


def quote(column: str, table: CampaignTable) -> str:
    """Quote the name of a column, or of a part of one: "legs.0.holes" is of the column legs."""
    known, (whole, _, part) = table.columns, column.partition(".")
    if column in known or whole not in known:
        return table.quote(column)
    quoted = table.quote(whole)
    keys = re.sub("""["']""", "", part).split(".")
    path = "".join(f"[{key}]" if key.isdigit() else f'."{key}"' for key in keys)
    return f"CASE WHEN json_valid({quoted}) THEN json_extract({quoted}, '${path}') END"


def select(
    table: CampaignTable, terms: Sequence[Term], where: Texts = (), sort: str = ""
) -> list[tuple[Any, ...]]:
    """Read the values of terms, one row a run, in the order of the runs, or sorted by a term."""
    order = [parse_term(sort.removeprefix("-"), table)] if sort else []
    conditions = [parse_term(text, table) for text in where]
    for text, condition in zip(where, conditions, strict=True):
        if not condition.is_rate:
            raise InputError("", f'"{text}" is not a condition, such as COLUMN=VALUE')
    parameters = [p for term in (*terms, *conditions, *order) for p in term.parameters]
    shown = ", ".join(term.sql for term in terms) or "NULL"
    kept = " AND ".join(f"({condition.sql})" for condition in conditions) or "1"
    keys = [f"{term.sql} {'DESC' * sort.startswith('-')} NULLS LAST, " for term in order]
    text = f"SELECT {shown} FROM runs WHERE {kept} ORDER BY {''.join(keys)}row"
    return list(table.query(text, parameters))


def parse_terms(table: CampaignTable, show: Texts = ()) -> list[Term]:
    """Parse terms; those of the campaign's file, or else `DEFAULT_TERMS`, if there are none."""
    known = table.columns
    usual = [text for text, needed in DEFAULT_TERMS.items() if all(n in known for n in needed)]
    if table.campaign.function:
        usual = ["exit=done", "wall_s:median"]
    return [parse_term(text, table) for text in show or table.campaign.show or usual]


def column_terms(table: CampaignTable, names: Texts) -> list[Term]:
    """Return columns themselves as terms; an `InputError` names one that is not there."""
    return [Term(name, quote(name, table), (), False, "") for name in names]


def group_runs(
    table: CampaignTable, by: Texts | None = None, show: Texts = (), where: Texts = ()
) -> GroupTable:
    """Group runs by columns, in the order in which they come, and collect the values of terms.

    Columns and terms are those of the file if none are given, or else those of its grid and
    `DEFAULT_TERMS`; runs must meet the conditions.
    """
    by = table.groups if by is None else by
    terms = parse_terms(table, show)
    found: dict[tuple[object, ...], list[tuple[object, ...]]] = {}
    for row in select(table, [*column_terms(table, by), *terms], where):
        found.setdefault(row[: len(by)], []).append(row[len(by) :])
    groups = []
    for key, rows in found.items():
        pairs = zip(terms, zip(*rows, strict=True), strict=True)
        groups.append(Group(key, len(rows), tuple(_evaluate(*pair) for pair in pairs)))
    return GroupTable(tuple(by), tuple(terms), tuple(groups))


def list_runs(
    table: CampaignTable,
    by: Texts | None = None,
    show: Texts = (),
    where: Texts = (),
    sort: str = "",
) -> tuple[list[str], list[list[str]]]:
    """List single runs as text, of errors the last line; arguments as of `group_runs`.

    They are sorted by a term, the largest values first after a minus, those without one last.
    """
    names = ["row", "seed", *(table.groups if by is None else by)]
    terms = [*column_terms(table, names), *parse_terms(table, show)]
    terms += column_terms(table, ["exit", "error"])
    rows = select(table, terms, where, sort)
    texts = [[format_value(cell).strip().rpartition("\n")[2] for cell in row] for row in rows]
    return [term.label for term in terms], texts


def _evaluate(term: Term, values: Sequence[Any]) -> Statistics:
    if text := next((value for value in values if isinstance(value, str)), None):
        hint = f"{term.label}={text} would show its rate"
        raise InputError("", f"{term.label} is a text, such as {format_input(text)}; {hint}")
    if term.is_rate and not set(values) <= {0, 1, None}:
        reason = "is true or false in some runs, and a number in others"
        raise InputError("", f"{term.label} {reason}; {term.label}=true would show its rate")
    return Statistics.of(values, term.is_rate)


def _as_number(text: str) -> object:
    if text in ("true", "false"):
        return text == "true"
    try:
        return float(text)
    except ValueError:
        return text
