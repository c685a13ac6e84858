"""Report of a check: the promises of a run, and the verdict on it, of which a line tells."""

from dataclasses import dataclass
from math import isfinite
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from numpy.typing import ArrayLike

from dynamics.doors import ANY_NUMBER, checked
from sato.scenario.errors import join_names
from sato.summary import format_value

Times = Float[Array, " times"] | None  # of instants [s]; may go on after the values
Verdict = Literal["kept", "not reached", "broken", "unchecked"]
JUDGED = ("broken", "verdict", "success")  # entries of a summary that say how a run was judged
LISTED = 3  # promises that are named in a line beside the first


class Promise(NamedTuple):
    """Property that a run must have, and the value that was found.

    Those of safety are named first where several are broken. A run that does not have what it
    aims at, such as a leg that is reached, breaks no other promise by that.
    """

    name: str
    kept: bool
    value: float  # worst violation, or the quantity itself
    tolerance: float  # largest value that keeps the promise
    message: str
    agents: tuple[int, ...] = ()  # of the value; none where they are not known
    time: float | None = None  # of the value [s]
    kind: Literal["record", "safety", "aim"] = "record"

    @property
    def text(self) -> str:
        """Message with agents and time: "0.053 m < 1 m, agents 0 and 1 at 17.3 s"."""
        plural = "s" * (len(self.agents) > 1)
        where = [f"agent{plural} {join_names(self.agents, 'and')}"] if self.agents else []
        where += [] if self.time is None else [f"at {round(self.time, 3):.9g} s"]
        return ", ".join(filter(None, [self.message, " ".join(where)]))


@checked
def expect_none(name: str, violations: ArrayLike, text: str, time: Times = None) -> Promise:
    """Promise that there are no violations, described in the plural.

    Violations are a number, or an array that is true at each. Of an array by instant and agent,
    with the times of the instants [s], the promise tells the first agent and time.
    """
    count = int(np.sum(violations))
    promise = Promise(name, not count, float(count), 0.0, f"{count or 'no'} {text}")
    return _locate(promise, np.not_equal(violations, 0), time) if count else promise


@checked
def expect_small_error(
    name: str, errors: ArrayLike, tolerance: float, text: str, time: Times = None
) -> Promise:
    """Promise that the largest of all errors is within its tolerance; times as `expect_none`."""
    worst = largest(errors)
    is_kept = bool(worst <= tolerance)
    message = f"{worst:.3g} {text}" + f", {tolerance:.3g} allowed" * (not is_kept)
    return _locate(Promise(name, is_kept, worst, tolerance, message), errors, time)


@checked
def expect_below(
    name: str, values: ArrayLike, limit: ArrayLike, relative: float, text: str, time: Times = None
) -> Promise:
    """Promise that quantities do not exceed their limits, but for a relative tolerance.

    The promise is about the value largest over its limit; times as of `expect_none`.
    """
    sizes, most = np.broadcast_arrays(np.abs(values), limit)
    if not sizes.size:
        return Promise(name, True, 0.0, 0.0, f"none {text}")
    shares = sizes / np.where(np.isinf(most), 1e300, np.maximum(most, 1e-300))
    value, least = (float(each.flat[int(np.argmax(shares))]) for each in (sizes, most))
    text = f"{format_value(value, least, 6)} {text}, {least:.6g} allowed"
    is_kept = bool(value <= least * (1 + relative))
    return _locate(Promise(name, is_kept, value, least, text), shares, time)


@checked
def expect_apart(
    distance: Annotated[float, ANY_NUMBER], allowed: float, agents: tuple[int, ...], time: float,
    error: float = 0.0, name: str = "separation", unit: str = "m", text: str = "",
) -> Promise:  # fmt: skip
    """Promise that agents, at a time [s], are as far apart as they must be, but for an error."""
    is_kept = bool(distance - error >= allowed)
    is_rounding = error <= 1e-12 * abs(distance)
    wrong = "" if is_rounding else f", up to {error:.2g} {unit} wrong,"
    sign = "≥" if is_kept else "<"
    limit = f"{format_value(allowed, digits=6)} {unit}"
    message = f"{format_value(distance, allowed)} {unit}{wrong} {sign} {limit}{text}"
    promise = Promise(name, is_kept, distance, allowed, message, kind="safety")
    return promise._replace(agents=agents, time=time) if isfinite(distance) else promise


def largest(*errors: ArrayLike) -> float:
    """Return the largest size in some arrays; NaN where there is one, which breaks a promise."""
    return float(np.max([np.max(np.abs(each), initial=0.0) for each in errors]))


def _locate(promise: Promise, values: ArrayLike, time: Times) -> Promise:
    sizes = np.abs(values)
    if time is None or not sizes.size:
        return promise
    place = np.unravel_index(int(np.argmax(sizes)), sizes.shape)
    agents = tuple(map(int, place[1:2]))
    return promise._replace(agents=agents, time=float(time[place[0]]))


@checked
@dataclass(frozen=True)
class Report:
    """Promises of a run, and the summary that was recomputed with them.

    The summary always has the entries `verdict` and `success`, by all promises; a summary that is
    given with `success` false makes the verdict "not reached" at best.
    """

    promises: tuple[Promise, ...]
    summary: dict[str, Any]  # as in summary.json, without time and memory
    skipped: tuple[str, ...] = ()  # promises that could not be recomputed
    skip_reason: str = ""  # as a sentence
    failure: str = ""  # fault that ended the check

    def __post_init__(self) -> None:
        """Write the verdict into the summary, in place of what it says of success."""
        entries = {**self.summary, "verdict": self.verdict, "success": self.kept}
        object.__setattr__(self, "summary", entries)

    @property
    def broken(self) -> tuple[Promise, ...]:
        """Promises that do not hold, of aims too."""
        return tuple(promise for promise in self.promises if not promise.kept)

    @property
    def verdict(self) -> Verdict:
        """Verdict: "kept" where all promises hold, and none was skipped.

        "broken" where one does not hold, else "not reached" where the run did not reach what it
        aimed at or was stopped, else "unchecked" where the check skipped promises, or failed.
        """
        kinds = {promise.kind for promise in self.broken}
        if kinds - {"aim"}:
            return "broken"
        if kinds:
            return "not reached"
        if self.skipped or self.failure:
            return "unchecked"
        return "kept" if self.summary.get("success", True) else "not reached"

    @property
    def kept(self) -> bool:
        """True where the verdict is "kept"."""
        return self.verdict == "kept"

    @property
    def line(self) -> str:
        """Verdict as one line: "BROKEN: separation, 0.053 m < 1 m, agents 0 and 1 at 17.3 s"."""
        return " ".join(f"{self.verdict.upper()}: {self._reason}".split())

    @property
    def _reason(self) -> str:
        verdict = self.verdict
        if verdict == "broken":
            wrong = [promise for promise in self.broken if promise.kind != "aim"]
            first, *others = sorted(wrong, key=lambda promise: promise.kind != "safety")
            names = [promise.name for promise in others]
            names[LISTED:] = [f"{len(names) - LISTED} more"] * (len(names) > LISTED)
            return f"{first.name}, {first.text}" + f"; also {', '.join(names)}" * bool(names)
        if verdict == "not reached":
            missed = (promise.text for promise in self.broken)
            return next(missed, "the check of the system says so")
        count = f"{len(self.promises)} promises"
        if self.failure:
            return f"the check ended early, {self.failure}"
        if verdict == "unchecked":
            return f"{count} hold, but {len(self.skipped)} were skipped, {self.skip_reason}"
        aims = [promise.message for promise in self.promises if promise.kind == "aim"]
        return ", ".join([count, *aims[-1:]])

    @property
    def entries(self) -> dict[str, Any]:
        """Entries of summary.json: the summary, and the promises that do not hold."""
        if self.failure:
            return {**self.summary, "check_failed": self.failure}
        return {**self.summary, "broken": [promise.name for promise in self.broken]}

    def __str__(self) -> str:
        """Tell the verdict, and the promises that do not hold."""
        lines = [self.line, *(f"  {each.name}: {each.text}" for each in self.broken)]
        return "\n".join([*lines, *(f"  {name}: skipped" for name in self.skipped)])

    def as_dict(self) -> dict[str, Any]:
        """Return everything as plain values, fit for JSON."""
        return {
            "verdict": self.verdict,
            "line": self.line,
            "kept": self.kept,
            "promises": [finite_or_none(promise._asdict()) for promise in self.promises],
            "skipped": list(self.skipped),
            "skip_reason": self.skip_reason,
            "summary": self.summary,
        }


def finite_or_none(value: Any) -> Any:
    """Replace numbers that JSON cannot hold, in lists and tables too."""
    if isinstance(value, float) and not isfinite(value):
        return None
    if isinstance(value, dict):
        return {key: finite_or_none(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [finite_or_none(part) for part in value]
    return value
