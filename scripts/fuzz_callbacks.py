"""Fly missions with wrong callbacks, drawn at random, beside the same missions with right ones.

    python scripts/fuzz_callbacks.py --count 300

Models, plants, solvers, progress functions, sticks, shapes, systems and functions of campaigns
return other shapes, types and numbers, write into their arguments, keep what they returned, and
raise, from a call on that is drawn too. Each must end in one of our sentences, with the name of
the callback, or fly what the right one flies, bit for bit; what was flown before must be equal.
The exit code is 1 where a raw error comes out, or a flight changes silently.
"""

import argparse
import sys
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from types import ModuleType
from typing import Any, NamedTuple
from unittest.mock import patch

import casadi
import numpy as np
from numpy.random import Generator

import sato
from dynamics.inputs import InputError
from problems import SolverAdapter, load_adapters
from sato.campaigns import trial as trials
from sato.connectivity.stick import WaypointStick
from sato.shapes import Points
from sato.shapes.shape import Drawing
from sato.systems import SYSTEMS

CROSSING = ["plan.solver=own", "model.speed_norm=inf", "plan.horizon_steps=7"]
SOLVED = 1e-5  # m and m/s, within which solvers agree


class Boom(Exception):
    """Exception of the user's own."""


EXCEPTIONS = (
    *(Boom, ValueError, KeyError, ZeroDivisionError, RuntimeError, StopIteration, TypeError),
    *(AttributeError, AssertionError, OSError, NotImplementedError, RecursionError, IndexError),
)


# Faults: of the arguments and the right result, and a memory, to what is returned.
def raise_exception(rng: Generator, arguments: list[Any], result: Any, memory: dict) -> Any:
    """Raise an exception in place of the result."""
    kind = memory.setdefault("kind", EXCEPTIONS[rng.integers(len(EXCEPTIONS))])
    raise kind(*["a fault of mine", ""][: memory.setdefault("words", int(rng.integers(3)))])


def write_in_place(rng: Generator, arguments: list[Any], result: Any, memory: dict) -> Any:
    """Write into the arrays that are given."""
    for value in arguments:
        if isinstance(value, np.ndarray) and value.size:
            value += 0.25
    return result


def write_by_force(rng: Generator, arguments: list[Any], result: Any, memory: dict) -> Any:
    """Write into them once they are made writeable."""
    for value in arguments:
        if isinstance(value, np.ndarray) and value.size:
            value.flags.writeable = True
            value += 0.25
    return result


def keep_buffer(rng: Generator, arguments: list[Any], result: Any, memory: dict) -> Any:
    """Return a buffer, and write into it at the next call."""
    if not isinstance(result, np.ndarray):
        return result
    for before in memory.setdefault("returned", []):
        before[:] = -7.0
    memory["returned"].append(result.copy())
    return memory["returned"][-1]


OTHERS: tuple[Callable[[Any], Any], ...] = (
    lambda result: None,
    lambda result: "nothing",
    lambda result: {3},
    lambda result: (part for part in range(3)),
    lambda result: object(),
    lambda result: 10**400,
    lambda result: [[1.0], [2.0, 3.0]],
    lambda result: casadi.SX.sym("s"),
    lambda result: len,
    lambda result: 3.0,
    lambda result: [],
    lambda result: b"bytes",
)
ARRAYS: tuple[Callable[[np.ndarray], Any], ...] = (
    lambda a: a[None],
    lambda a: a[..., None],
    lambda a: a[:-1],
    lambda a: a[..., :1],
    lambda a: a[..., :-1],
    lambda a: a.ravel()[:-1],
    lambda a: np.concatenate([a, a]),
    lambda a: a.sum(),
    lambda a: np.where(np.arange(a.size).reshape(a.shape) == a.size // 2, np.nan, a),
    lambda a: np.where(np.arange(a.size).reshape(a.shape) == a.size // 2, np.inf, a),
    lambda a: a * (1 + 0j),
    lambda a: a > 0,
    lambda a: a.astype(object),
    lambda a: a.astype(str),
    lambda a: np.ma.masked_array(a, a > 0),
    lambda a: a.tolist(),  # right, as the next three
    lambda a: np.asfortranarray(a),
    lambda a: tuple(a),
    lambda a: a.astype(np.longdouble),
)


SYMBOLIC: tuple[Callable[[Any], Any], ...] = (
    lambda column: column.T,
    lambda column: column[2:],
    lambda column: column + casadi.SX.sym("free"),
    lambda column: casadi.vertcat(column, 0),
    lambda column: casadi.MX.sym("x", 4),
    lambda column: casadi.DM.zeros(4),
    lambda column: column + casadi.vertcat(0, 0, casadi.sqrt(column[0]), 0),
    lambda column: column + casadi.vertcat(0, 0, 1e-3 * casadi.log(casadi.sumsqr(column)), 0),
    lambda column: casadi.vertsplit(column),  # right, as the next
    lambda column: np.array(casadi.vertsplit(column), dtype=object),
)


def return_other(rng: Generator, arguments: list[Any], result: Any, memory: dict) -> Any:
    """Return something else."""
    other = OTHERS[memory.setdefault("other", rng.integers(len(OTHERS)))]
    return other(result)


def spoil_array(rng: Generator, arguments: list[Any], result: Any, memory: dict) -> Any:
    """Return an array, or one of several, that is not as it should be."""
    spoil = ARRAYS[memory.setdefault("spoil", rng.integers(len(ARRAYS)))]
    if isinstance(result, np.ndarray) and result.ndim and result.size:
        return spoil(result)
    if isinstance(result, casadi.SX):
        return SYMBOLIC[memory.setdefault("symbolic", rng.integers(len(SYMBOLIC)))](result)
    if isinstance(result, tuple):  # one of its arrays, or none
        i = memory.setdefault("part", rng.integers(len(result)))
        part = result[i]
        part = spoil(part) if isinstance(part, np.ndarray) and part.size else "part"
        rest = [*result[:i], part, *result[i + 1 :]]
        return type(result)(*rest) if hasattr(result, "_fields") else tuple(rest)
    return [result]


FAULTS = raise_exception, write_in_place, write_by_force, keep_buffer, return_other, spoil_array


class Fault:
    """Fault of one method or function, from one of its calls on; none by default."""

    def __init__(self, spoil: Callable[..., Any] | None, first: int, rng: Generator) -> None:
        self.spoil, self.first, self.rng, self.count = spoil, first, rng, 0
        self.memory: dict[str, Any] = {}

    def of(self, arguments: list[Any], result: Any) -> Any:
        """Return the result of a call, or what is wrong in its place."""
        self.count += 1
        if self.spoil is None or self.count <= self.first:
            return result
        return self.spoil(self.rng, arguments, result, self.memory)


ANGLE = np.arange(3) * 2 * np.pi / 3
RING = np.c_[np.cos(ANGLE), np.sin(ANGLE)]


def mission(**changes: Any) -> Any:
    """Make a small mission."""
    plain = dict(
        model=sato.DoubleIntegrator(2),
        start=2 * RING,
        legs=[sato.Leg(-2.2 * RING, steps=10)],
        step=1.0,
        comm_radius=20.0,
        collision_radius=0.4,
        max_control=0.4,
        max_speed=1.0,
    )
    return sato.Reconfiguration(**plain | changes)


def drag(t: float) -> np.ndarray:
    """Compute the matrix of linear drag."""
    return np.block([[np.zeros((2, 2)), np.eye(2)], [np.zeros((2, 2)), -0.1 * np.eye(2)]])


def fly_linear(fault: Fault, name: str) -> Any:
    """Fly a linear model."""

    class Own(sato.LinearModel):
        axes = 2

        def A(self, t: float) -> Any:
            return fault.of([], drag(t)) if name == "A" else drag(t)

        def B(self, t: float) -> Any:
            B = np.eye(4, 2, -2)
            return fault.of([], B) if name == "B" else B

        def z(self, t: float) -> Any:
            z = np.array([0.0, 0.0, 0.01, 0.0])
            return fault.of([], z) if name == "z" else z

        def matrices(self, times: Any) -> Any:
            found = tuple(np.array([part(t) for t in times]) for part in (self.A, self.B, self.z))
            return fault.of([times], found) if name == "matrices" else found

    return sato.run(mission(model=Own()))


def fly_nonlinear(fault: Fault, name: str) -> Any:
    """Fly a nonlinear model."""

    class Own(sato.NonlinearModel):
        axes = 2

        def rate(self, t: Any, x: Any, u: Any) -> Any:
            v = x[..., 2:]
            found = np.concatenate([v + 0 * u, u - 0.1 * v * np.sqrt(1 + v * v)], axis=-1)
            found = found + np.zeros((*np.shape(t), 1))
            return fault.of([x, u], found) if name == "rate" else found

        def jacobian(self, t: Any, x: Any, u: Any) -> Any:
            lead = np.broadcast_shapes(np.shape(t), x.shape[:-1], u.shape[:-1])
            A, v = np.zeros((*lead, 4, 4)), x[..., 2:]
            A[..., 0, 2] = A[..., 1, 3] = 1.0
            slope = -0.1 * (1 + 2 * v * v) / np.sqrt(1 + v * v)
            A[..., 2, 2], A[..., 3, 3] = slope[..., 0], slope[..., 1]
            B = np.broadcast_to(np.eye(4, 2, -2), (*lead, 4, 2)).copy()
            return fault.of([x, u], (A, B)) if name == "jacobian" else (A, B)

    return sato.run(mission(model=Own()))


def fly_symbolic(fault: Fault, name: str) -> Any:
    """Fly a model of symbols."""

    def expression(t: Any, x: Any, u: Any) -> Any:
        speed = casadi.sqrt(1 + casadi.sumsqr(x[2:]))
        return fault.of([], casadi.vertcat(x[2:], u - 0.1 * speed * x[2:]))

    return sato.run(mission(model=sato.SymbolicModel(2, expression)))


def fly_plant(fault: Fault, name: str) -> Any:
    """Fly a plant."""

    class Own(sato.Plant):
        def propagate(self, x: Any, u: Any, t: float, dt: float, substeps: int = 1) -> Any:
            states, h, now = [x], dt / substeps, x
            for _ in range(substeps):
                v = now[:, 2:]
                now = np.hstack([now[:, :2] + h * v + h * h / 2 * u, v + h * (u - 0.02 * v)])
                states.append(now)
            found = np.array(states)
            return fault.of([x, u], found) if name == "propagate" else found

        def chief_elements(self, t: float) -> Any:
            return fault.of([], None) if name == "chief_elements" else None

    return sato.run(mission(plant=Own()))


def fly_solver(fault: Fault, name: str) -> Any:
    """Plan by a solver."""

    class Own:
        def __init__(self, program: Any, tolerance: float) -> None:
            self.program, self.session = program, load_adapters()["clarabel"].session_factory
            if name == "__init__":
                fault.of([program.q, program.b, program.A.data], None)

        def solve(self, b: Any) -> Any:
            found = self.session(self.program, 1e-9).solve(b)
            given = [b, self.program.q, self.program.A.data]
            return fault.of(given, found) if name == "solve" else found

    adapter = SolverAdapter("own", frozenset({"linear", "second-order"}), False, Own, "clarabel")
    with patch.dict(load_adapters(), own=adapter):
        return sato.run("crossing", overrides=CROSSING)


def fly_watched(fault: Fault, name: str) -> Any:
    """Watch a flight."""

    def watch(mission: Any, frame: Any) -> Any:
        for event in frame.events:
            event.clear()
        return fault.of([frame.position, frame.velocity, frame.alive], None)

    return sato.run(mission(), progress=watch)


def fly_stick(fault: Fault, name: str) -> Any:
    """Steer a team by a stick."""

    class Own(WaypointStick):
        def command_velocity(self, time: float, position: Any, reached: int) -> Any:
            found = super().command_velocity(time, position, reached)
            return fault.of([position], found) if name == "command_velocity" else found

        def has_arrived(self, position: Any, reached: int) -> Any:
            found = super().has_arrived(position, reached)
            return fault.of([position], found) if name == "has_arrived" else found

    steered = sato.read("connectivity", ["run.duration_s=0.4", "swarm.agents=3"])

    return sato.run(replace(steered, stick=Own(start_time=0.1)))


def fly_shape(fault: Fault, name: str) -> Any:
    """Fly to a shape."""

    class Own(Points):
        def draw(self, count: int, axes: int) -> Any:
            found = Drawing(-2.2 * RING[:count], np.zeros(2))
            return fault.of([], found) if name == "draw" else found

        def place_velocities(self, count: int, axes: int) -> Any:
            found = np.zeros((count, axes))
            return fault.of([], found) if name == "place_velocities" else found

    return sato.run(mission(legs=[sato.Leg(Own(-2.2 * RING), steps=10)]))


def fly_system(fault: Fault, name: str) -> Any:
    """Fly a system."""
    from sato.reconfiguration.loop import simulate as fly_library
    from sato.reconfiguration.system import SYSTEM

    def simulate(drawn: Any, rng: Generator) -> Iterator[Any]:
        for frame in fly_library(drawn, rng):
            yield fault.of([], frame)

    module = ModuleType("own_system")
    module.SYSTEM = replace(SYSTEM, simulate=simulate)
    definition = SYSTEMS["reconfiguration"][0]
    sys.modules["own_system"] = module
    with patch.dict(SYSTEMS, reconfiguration=(definition, "own_system:SYSTEM")):
        return sato.run(mission())


def fly_trial(fault: Fault, name: str) -> Any:
    """Return the cells of a row, of a campaign with functions of the user's own."""

    def solve(rng: Generator) -> Any:
        return fault.of([], {"gap": 0.5, "count": 3})

    def draw(rng: Generator) -> Any:
        return fault.of([], mission()) if name == "draw" else mission()

    def more(run: Any) -> Any:
        run.summary["fuel_m_s"] = -1.0
        columns, arrays = {"instants": run.data.sizes["time"]}, [run.data["position"].values]
        return fault.of(arrays, columns) if name == "more" else columns

    module = ModuleType("own_campaign")
    module.solve, module.draw, module.more = solve, draw, more
    trial = trials.Trial(0, "own_campaign:draw", {}, 0, (0, 0), columns="own_campaign:more")
    if name == "solve":
        trial = trial._replace(source="", function="own_campaign:solve", columns="")
    sys.modules["own_campaign"] = module
    return trials.run_trial(trial)


class Subject(NamedTuple):
    """Function or method of a user's own, and the flight that calls it."""

    fly: Callable[[Fault, str], Any]
    method: str
    name: str  # in our sentences


SUBJECTS = [
    *(Subject(fly_linear, name, f"Own.{name}") for name in ("A", "B", "z", "matrices")),
    *(Subject(fly_nonlinear, name, f"Own.{name}") for name in ("rate", "jacobian")),
    Subject(fly_symbolic, "expression", "SymbolicModel.expression expression"),
    *(Subject(fly_plant, name, f"Own.{name}") for name in ("propagate", "chief_elements")),
    Subject(fly_plant, "propagate", "Own.propagate"),  # twice as often
    *(Subject(fly_solver, name, "Own") for name in ("__init__", "solve")),
    Subject(fly_watched, "watch", "watch"),
    *(Subject(fly_stick, name, f"Own.{name}") for name in ("command_velocity", "has_arrived")),
    *(Subject(fly_shape, name, f"Own.{name}") for name in ("draw", "place_velocities")),
    Subject(fly_system, "simulate", "simulate"),
    *(Subject(fly_trial, name, f"own_campaign:{name}") for name in ("solve", "draw", "more")),
]


@dataclass
class Truth:
    """Flight or cells of a right callback."""

    states: Any  # of the right callback
    cells: dict[str, Any]
    calls: int


@cache
def truth_of(subject: Subject) -> Truth:
    """Fly with the right callback."""
    fault = Fault(None, 0, np.random.default_rng(0))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = subject.fly(fault, subject.method)
    if isinstance(found, dict):
        return Truth(None, _cells(found), fault.count)
    assert not found.summary.get("broken"), found.summary["broken"]
    return Truth(_states(found), {}, fault.count)


def _states(run: Any) -> np.ndarray:
    return np.concatenate([run.recorded["position"], run.recorded["velocity"]], axis=-1)


def _cells(row: dict[str, Any]) -> dict[str, Any]:
    measured = ("wall_s", "peak_memory_mib", "worker")
    flat = {key: value for key, value in row.items() if key not in measured}
    flat["summary"] = {k: v for k, v in row.get("summary", {}).items() if k not in measured}
    return flat


def judge(subject: Subject, fault: Fault) -> tuple[str, str]:
    """Fly with a wrong callback: how it ended, "wrong" where it may not, and what was said."""
    truth = truth_of(subject)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            found = subject.fly(fault, subject.method)
        except InputError as error:
            said = str(error)
            return ("refused" if subject.name in said else "wrong", said)
        except BaseException as error:
            return "wrong", f"raw {type(error).__name__}: {error}"
    said = "; ".join(str(each.message) for each in caught if each.category is UserWarning)
    if isinstance(found, dict):
        return _judge_row(subject, truth, found)
    summary, states = found.summary, _states(found)
    said += summary.get("stopped", "") + summary.get("check_failed", "")
    known = truth.states[: len(states)]
    tolerance = SOLVED if subject.fly is fly_solver else 0.0
    is_same = states.shape == known.shape and np.allclose(
        states, known, rtol=0, atol=tolerance, equal_nan=True
    )
    if "check_failed" in summary and subject.name not in said:
        return "wrong", f"raw error in the check: {said}"
    if not is_same:
        return "wrong", f"another flight; {said or 'silently'}"
    if subject.name in said:
        return ("stopped" if "stopped" in summary else "told"), said
    is_whole = len(states) == len(truth.states) and not summary.get("broken")
    return ("right" if is_whole else "wrong"), said or f"broken: {summary.get('broken')}"


def _judge_row(subject: Subject, truth: Truth, row: dict[str, Any]) -> tuple[str, str]:
    said = str(row.get("error") or row.get("columns", {}).get("columns_error", ""))
    is_told = "CallbackError" in said or ": the result must" in said
    if subject.name in said and is_told:
        expected = truth.cells["summary"] if subject.method == "more" else {}
        return ("told" if _cells(row)["summary"] == expected else "wrong"), said[-200:]
    return ("right" if _cells(row) == truth.cells else "wrong"), said or "another row, silently"


def draw_fault(rng: Generator, subject: Subject) -> Fault:
    """Draw a fault, and the call from which on a callback has it."""
    spoil = FAULTS[rng.integers(len(FAULTS))]
    first = 0 if rng.random() < 0.5 else int(rng.integers(max(truth_of(subject).calls, 1)))
    return Fault(spoil, first, rng)


def main() -> int:
    """Draw wrong callbacks, and say how each ended."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--count", type=int, default=300, help="callbacks that are drawn")
    parser.add_argument("--seed", type=int, default=0, help="random seed")
    parser.add_argument("--verbose", action="store_true", help="print each sentence")
    options = parser.parse_args()
    counts: Counter[str] = Counter()
    for number in range(options.count):
        rng = np.random.default_rng([options.seed, number])
        subject = SUBJECTS[rng.integers(len(SUBJECTS))]
        fault = draw_fault(rng, subject)
        ended, said = judge(subject, fault)
        counts[ended] += 1
        if ended == "wrong" or options.verbose:
            memory = {key: str(value)[:40] for key, value in fault.memory.items()}
            drawn = f"{fault.spoil.__name__} {memory} from call {fault.first}"
            place = f"{number}: {subject.fly.__name__} {subject.method}, {drawn}"
            print(f"{ended:8}{place}\n        {said}")
    print(", ".join(f"{ended} {count}" for ended, count in sorted(counts.items())))
    return 1 if counts["wrong"] else 0


if __name__ == "__main__":
    sys.exit(main())
