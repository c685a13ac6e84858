"""Callbacks: faults of a user's own functions are told by name, and change no flight."""

import re
import sys
import warnings
from dataclasses import replace
from functools import partial, partialmethod
from itertools import count
from pathlib import Path

import casadi
import numpy as np
import pytest

import dynamics
import sato
from dynamics import discretize_zoh
from dynamics.callbacks import CallbackError
from problems import SolverAdapter, load_adapters
from sato.connectivity.stick import WaypointStick
from sato.reconfiguration.own_motion import check_authority
from sato.scenario.errors import InputError

COUNT = count(1)
LINE = np.array([[0.0, 0.0], [2.0, 0.0]])
CROSSING = ["plan.solver=mine", "model.speed_norm=inf", "plan.horizon_steps=7"]


def mission(**changes):
    plain = dict(
        model=sato.DoubleIntegrator(2), start=LINE, legs=[sato.Leg(LINE + np.array([0, 4]), 20)]
    )
    plain |= dict(step=1.0, comm_radius=20.0, collision_radius=0.5, max_control=0.4, max_speed=1.0)
    return sato.Reconfiguration(**plain | changes)


class Drag(sato.LinearModel):
    """Linear drag."""

    axes = 2

    def A(self, t):
        return np.block([[np.zeros((2, 2)), np.eye(2)], [np.zeros((2, 2)), -0.1 * np.eye(2)]])


class Wind(sato.Plant):
    """Euler steps, which may fail at a time."""

    fails_at = np.inf

    def propagate(self, x, u, t, dt, substeps=1):
        if t == self.fails_at:
            raise ArithmeticError("no wind")
        states, h = [x], dt / substeps
        for _ in range(substeps):
            v = states[-1][:, 2:]
            states.append(states[-1] + h * np.hstack([v, u]))
        return np.array(states)


class Calm(Wind):
    """A plant that fails in the middle of a flight."""

    fails_at = 8.0


class InPlace(sato.Plant):
    """The same steps, written into the states that are given."""

    def propagate(self, x, u, t, dt, substeps=1):
        states, h = [x.copy()], dt / substeps
        for _ in range(substeps):
            x += h * np.hstack([x[:, 2:], u])
            states.append(x.copy())
        return np.array(states)


class Copied(InPlace):
    """The same steps, written into a copy."""

    def propagate(self, x, *rest, **more):
        return super().propagate(x.copy(), *rest, **more)


def states(run):
    return np.concatenate([run.recorded["position"], run.recorded["velocity"]], axis=-1)


def test_a_plant_that_writes_into_its_states_is_told_so():
    with pytest.raises(InputError, match=r"InPlace\.propagate.* writes into .*test_callbacks\.py:"):
        sato.run(mission(plant=InPlace()))
    copied, right = sato.run(mission(plant=Copied())), sato.run(mission(plant=Wind()))
    assert np.array_equal(states(copied), states(right))


def lacking(name, value, **more):
    return type("Own", (Drag,), {name: lambda self, t: value, **more})()


@pytest.mark.parametrize(
    "wind",
    [lambda t: 3 <= t <= 5, lambda t: np.sin(2 * np.pi * t), lambda t: np.sin(4 * np.pi * t)],
)
def test_forces_that_change_between_steps_are_not_time_invariant(wind):
    z = {"z": lambda self, t: np.array([0.0, 0.0, 0.05 * wind(t), 0.0])}
    model = type("Own", (Drag,), z | {"is_time_invariant": True})()
    with pytest.raises(InputError, match="z changes with time; is_time_invariant = False would"):
        sato.run(mission(model=model))


class Failing(sato.Plant):
    """A motion whose second motor fails after 5 s."""

    def propagate(self, x, u, t, dt, substeps=1):
        left = u * [[1.0], [t < 5]]
        h = dt * np.arange(substeps + 1)[:, None, None] / substeps
        place, speed = x[:, :2], x[:, 2:]
        return np.concatenate([place + h * speed + h**2 / 2 * left, speed + h * left], axis=2)


def test_tolerances_in_which_all_arrives_are_doubted():
    start, goal = [[0.0, 0.0], [3.0, 0.0]], [[0.0, 3.0], [3.0, 3.0]]
    limits = {"collision_radius": 0.5, "max_control": 0.2, "max_speed": 1.0, "comm_radius": 20.0}
    flown = sato.Reconfiguration(
        model=sato.DoubleIntegrator(2), start=start, legs=[sato.Leg(goal, 14)], step=1.0,
        plant=Failing(), **limits,
    )  # fmt: skip
    with pytest.warns(UserWarning, match=r"the plant does otherwise .* who passes by has"):
        sato.run(flown)


def test_controls_of_an_unstable_model_reach_every_state():
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [0.04 * np.eye(2), np.zeros((2, 2))]])
    check_authority("Own", discretize_zoh(lacking("A", A), 1.0, 151))


@pytest.mark.parametrize(
    ("model", "reason"),
    [
        (lacking("B", np.array([[0], [0], [1.0], [0]])), r"Own\.B\(t=0\).*\(4, 2\), got \(4, 1\)"),
        (lacking("A", np.zeros((2, 2))), r"Own\.A\(t=0\).*\(4, 4\), got \(2, 2\)"),
        (lacking("A", np.full((4, 4), np.nan)), r"Own\.A\(t=0\).* finite, got nan at \[0, 0\]"),
        (lacking("A", np.eye(4) * 1j), r"Own\.A\(t=0\).*complex128"),
        (lacking("z", None), r"Own\.z\(t=0\).* a return is missing"),
        (lacking("z", [[1.0], [2.0, 3.0]]), r"Own\.z\(t=0\).* rows of one length"),
        (lacking("B", np.eye(4, 2)), "rate of the position must be the velocity"),
        (lacking("A", np.zeros((4, 4))), "rate of the position must be the velocity"),
        (lacking("B", np.zeros((4, 2))), r"Own\.B: controls move 0 of 4 directions"),
        (lacking("B", np.eye(4, 2, -2) * [1, 0]), r"Own\.B: controls move 2 of 4 directions"),
        (lacking("A", Drag().A(0.0) @ np.diag([1, 1, 1, 100])), "rate of the position"),
        (lacking("A", np.eye(4, 4, 2) - 10 * np.diag([0, 0, 1, 1])), "step_s = 0.1 would do"),
        (lacking("axes", None, axes=4), r"Own\.axes must be 2 or 3, got 4"),
        (lacking("axes", None, axes=2.0), r"Own\.axes must be 2 or 3, got 2\.0"),
        (sato.SymbolicModel(2, lambda t, x, u: casadi.horzcat(x[2:].T, u.T)), r"\(1, 4\)"),
        (sato.SymbolicModel(2, lambda t, x, u: u), "column of 4 entries, got SX of shape"),
        (
            sato.SymbolicModel(2, lambda t, x, u: casadi.vertcat(x[2:], casadi.SX.sym("w"), 0)),
            "sym",
        ),
        (
            sato.SymbolicModel(
                2, lambda t, x, u: casadi.vertcat(x[2:], u - casadi.sqrt(casadi.sumsqr(x)) * x[2:])
            ),
            "finite, got nan .*at rest",
        ),
    ],
)
def test_a_wrong_model_is_refused_by_the_name_of_its_method(model, reason):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with pytest.raises(InputError, match=reason) as refused:
            sato.run(mission(model=model))
    assert str(refused.value).count("\n") == 0


class Friction(sato.NonlinearModel):
    """Drag that grows with the square of the speed."""

    axes, wrong = 2, np.zeros((4, 6))

    def rate(self, t, x, u):
        v = x[..., 2:]
        speed = np.sqrt(1e-6 + (v * v).sum(axis=-1, keepdims=True))
        return np.concatenate([v, u - 0.06 * speed * v], axis=-1)

    def jacobian(self, t, x, u):
        v, A = x[..., 2:], np.zeros((*x.shape, 4))
        speed = np.sqrt(1e-6 + (v * v).sum(axis=-1))[..., None, None]
        A[..., :2, 2:] = np.eye(2)
        A[..., 2:, 2:] = -0.06 * (speed * np.eye(2) + v[..., None] * v[..., None, :] / speed)
        return A + self.wrong[:, :4], np.eye(4, 2, -2) + self.wrong[:, 4:]


def test_a_jacobian_is_that_of_the_rate():
    assert sato.run(mission(model=Friction())).summary["reached"]


class Terrain(Friction):
    """A slope that changes at every meter, as by a table, where the starts may be."""

    def rate(self, t, x, u):
        force = np.interp(x[..., :1], np.arange(-5, 99), 0.001 * np.arange(104) ** 2)
        return super().rate(t, x, u) + force * [0, 0, 1, 0]

    def jacobian(self, t, x, u):
        A, B = super().jacobian(t, x, u)
        A[..., 2, 0] += 0.001 * (2 * np.floor(x[..., 0] + 5) + 1)
        return A, B


def test_a_jacobian_is_tried_where_no_table_has_a_row():
    assert mission(model=Terrain()).draw(np.random.default_rng(0))


@pytest.mark.parametrize(("i", "j"), [(2, 2), (3, 2), (2, 0), (3, 5)])
def test_a_jacobian_that_is_not_that_of_the_rate_is_refused(i, j):
    wrong = np.zeros((4, 6))
    wrong[i, j] = 0.02
    part = f"∂f/∂x[{i}, {j}]" if j < 4 else f"∂f/∂u[{i}, {j - 4}]"
    reason = rf"^model: Wrong\.jacobian: {re.escape(part)} must be .* Wrong\.rate, got .* would do"
    with pytest.raises(InputError, match=reason):
        sato.run(mission(model=type("Wrong", (Friction,), {"wrong": wrong})()))


def test_a_method_of_the_library_that_is_extended_is_checked_once(monkeypatch):
    class Same(dynamics.J2):
        def rate(self, t, x, u):
            return super().rate(t, x, u)

    orbit, checks = dynamics.Orbit.from_elements(7e6), []
    models, state = (dynamics.J2(orbit), Same(orbit)), np.array([[10.0, 0, 0, 0, 0, 0]])
    monkeypatch.setattr("dynamics.doors._check_call", lambda *given: checks.append(given))
    rates = [model.rate(0.0, state, np.zeros((1, 3))) for model in models]
    assert np.array_equal(*rates) and len(checks) == 1


@pytest.mark.parametrize("kind", ["class", "attribute", "later"])
@pytest.mark.parametrize(
    ("value", "reason"),
    [(np.eye(4, 1, -2), r"\(4, 2\), got \(4, 1\)"), (np.full((4, 2), np.nan), "finite")],
)
def test_methods_are_checked_however_they_come_into_an_object(kind, value, reason):
    model = lacking("B", value) if kind == "class" else type("Own", (Drag,), {})()
    if kind == "attribute":
        model.B = lambda t: value
    elif kind == "later":
        type(model).B = lambda self, t: value
    with pytest.raises(InputError, match=rf"Own\.B\(t=0\).*{reason}"):
        mission(model=model)


def test_a_plant_whose_method_is_an_attribute_is_checked():
    plant = Wind()
    plant.propagate = lambda x, *rest: Wind().propagate(x, *rest)[1:]
    with pytest.raises(InputError, match=r"Wind\.propagate\(t=0\).*got \(2, 2, 4\)"):
        sato.run(mission(plant=plant))


def test_methods_of_every_kind_that_python_calls_are_methods():
    def friction(rate, t):
        return Drag().A(t) * (rate / 0.1)

    class Bound(Drag):
        def scaled(self, rate, t):
            return friction(rate, t)

        A = partialmethod(scaled, 0.1)

    kinds = [staticmethod(partial(friction, 0.1)), classmethod(lambda cls, t: friction(0.1, t))]
    if sys.version_info < (3, 13):  # which warns that a later Python will bind it
        kinds.append(partial(friction, 0.1))
    models = [Bound(), *(lacking("A", None, A=kind) for kind in kinds)]
    for model in models:
        assert mission(model=model) and np.array_equal(model.A(0.0), Drag().A(0.0))


def test_a_model_repeats_itself():
    times = count(1)
    model = type(
        "Own",
        (Drag,),
        {"A": lambda self, t: Drag().A(t) - 0.01 * np.diag([0, 0, 0, 1]) * next(times)},
    )()
    with pytest.raises(InputError, match="Own returns other matrices for the same times"):
        mission(model=model)


def test_a_model_that_changes_with_time_does_not_say_otherwise():
    A = np.eye(4, 4, 2) + 0.0
    changing = {"A": lambda self, t: A * (1 + 0 * t) - t * 1e-3 * np.diag([0, 0, 1, 1])}
    model = type("Own", (Drag,), {**changing, "is_time_invariant": True})()
    with pytest.raises(InputError, match=r"Own\.is_time_invariant is True, and A changes"):
        mission(model=model)
    assert sato.run(mission(model=type("Own", (Drag,), changing)())).summary["reached"]


@pytest.mark.parametrize("name", ["matrices", "rate"])
def test_methods_of_a_linear_model_are_of_one_motion(name):
    def changed(self, *given):
        result = getattr(super(type(model), self), name)(*given)
        return 1.01 * result if name == "rate" else (0.99 * result[0], *result[1:])

    model = type("Own", (Drag,), {name: changed})()
    with pytest.raises(InputError, match=r"Own\.\w+ is of another motion than its matrices|Own:"):
        mission(model=model)


def test_results_of_other_types_with_the_right_numbers_are_converted():
    class Listed(Drag):
        def A(self, t):
            return super().A(t).tolist()

        def B(self, t):
            return np.eye(4, 2, -2, dtype=int)

    expected = dynamics.discretize_zoh(Drag(), 1.0, 3)
    found = dynamics.discretize_zoh(Listed(), 1.0, 3)
    assert np.array_equal(found.A, expected.A) and np.array_equal(found.B, expected.B)


def test_arrays_that_a_callback_keeps_are_its_own():
    class Kept(Drag):
        def __init__(self):
            self.kept = np.zeros((4, 4))

        def A(self, t):
            self.kept[:] = super().A(t)
            return self.kept

    model = Kept()
    first = model.A(0.0)
    model.kept[:] = 7.0
    assert np.array_equal(first, Drag().A(0.0))


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda states, x: states[1:], r"\(2, 2, 4\), got \(1, 2, 4\)"),
        (lambda states, x: states + 1e-3, "must begin with the given states"),
        (lambda states, x: np.where(np.arange(4) == 2, np.nan, states), "finite"),
        (lambda states, x: states + np.array([0, next(COUNT)])[:, None, None], "other"),
    ],
)
def test_a_plant_is_tried_before_anything_is_flown(spoil, reason):
    class Own(Wind):
        def propagate(self, x, u, t, dt, substeps=1):
            found = super().propagate(x, u, t, dt, substeps)
            return spoil(found, x) if substeps == 1 else found

    with pytest.raises(InputError, match=rf"Own\.propagate.*{reason}"):
        sato.run(mission(plant=Own()))


@pytest.mark.parametrize("delay", [1, 2])
@pytest.mark.parametrize("is_reset", [False, True])
def test_plant_that_remembers_earlier_controls_is_refused(delay, is_reset):
    class Lag(Wind):
        earlier = ()

        def propagate(self, x, u, t, dt, substeps=1):
            earlier = () if is_reset and t == 0 else self.earlier
            late = earlier[-delay] if len(earlier) >= delay else u
            self.earlier = (*earlier, u.copy())
            return super().propagate(x, 0.9 * u + 0.1 * late, t, dt, substeps)

    with pytest.raises(InputError, match=r"Lag\.propagate returns other states for the same"):
        sato.run(mission(plant=Lag()))


def test_gust_of_a_model_that_says_it_is_time_invariant_is_refused():
    class Gust(Drag):
        is_time_invariant = True

        def z(self, t):
            return np.array([0.0, 0.0, 0.05 * (8 < t < 9), 0.0])

    with pytest.raises(InputError, match=r"Gust.is_time_invariant is True, and z changes"):
        mission(model=Gust())


def test_symbolic_model_of_chance_is_refused():
    rng = np.random.default_rng(0)
    model = sato.SymbolicModel(2, lambda t, x, u: casadi.vertcat(x[2:], u + rng.normal(0, 0.01, 2)))
    with pytest.raises(InputError, match=r"SymbolicModel.expression is another each time"):
        sato.run(mission(model=model))


@pytest.mark.parametrize(
    ("steps", "reason"),
    [
        (25, "leg.0.steps: agent 0 can reach none of its"),
        (80, "model: is so unstable that rounding decides what 80 steps of leg 0 do"),
        (1500, "model: is so unstable that rounding decides"),
        (2500, "model: is so unstable that states grow beyond numbers"),
    ],
)
def test_unstable_model_is_refused_in_words(steps, reason):
    class Unstable(sato.LinearModel):
        axes, is_time_invariant = 2, True

        def A(self, t):
            return np.block([[np.zeros((2, 2)), np.eye(2)], [0.2 * np.eye(2), np.zeros((2, 2))]])

    with pytest.raises(InputError, match=reason):
        sato.run(
            mission(
                model=Unstable(), legs=[sato.Leg(LINE + np.array([0, 8]), steps)], max_control=0.2
            )
        )


def test_rows_of_absent_agents_may_be_anything():
    x = np.array([[0.0, 0, 1, 0], [np.nan] * 4])
    found = Wind().propagate(x, np.zeros((2, 2)), 0.0, 1.0)
    assert np.isnan(found[:, 1]).all() and found[1, 0, 0] == 1.0


def test_what_was_flown_before_a_plant_raises_is_kept(tmp_path):
    whole = sato.run(mission(plant=Wind()))
    part = sato.run(mission(plant=Calm()))
    said = part.summary["stopped"]
    assert said.startswith(
        "Calm.propagate(t=8) raised ArithmeticError: no wind (test_callbacks.py:"
    )
    assert len(part.recorded["time"]) == 9
    assert np.array_equal(states(part), states(whole)[:9])
    part.save(tmp_path)
    assert sato.load(tmp_path).summary["stopped"] == said


def test_strict_raises_an_exception_as_it_is():
    with pytest.raises(ArithmeticError, match=r"^no wind$"):
        sato.run(mission(plant=Calm()), strict=True)

    def watch(mission, frame):
        raise LookupError("no display")

    with pytest.raises(LookupError, match=r"^no display$"):
        sato.run(mission(), progress=watch, strict=True)


def test_a_plant_that_throws_a_vehicle_ends_the_flight_in_words():
    class Throw(Wind):
        def propagate(self, x, u, t, dt, substeps=1):
            states = super().propagate(x, u, t, dt, substeps)
            states[1:, 0, 2] += 1e6 * (t == 8)
            return states

    said = sato.run(mission(plant=Throw())).summary["stopped"]
    assert said.startswith("agent 0 flies at 1e+06 m/s, over 100 times model.max_speed_m_s")


@pytest.mark.parametrize("size", [np.nan, 1e40])
def test_strict_names_the_callback_of_a_wrong_result(size):
    class Jump(Wind):
        def propagate(self, x, u, t, dt, substeps=1):
            return super().propagate(x, u, t, dt, substeps) * (size if t == 8 else 1)

    with pytest.raises(InputError, match=r"^Jump.propagate\(t=8\): the result must be"):
        sato.run(mission(plant=Jump()), strict=True)


def test_an_interrupt_passes_through_a_callback():
    class Stopped(Wind):
        def propagate(self, x, u, t, dt, substeps=1):
            if t == 4.0:
                raise KeyboardInterrupt
            return super().propagate(x, u, t, dt, substeps)

    assert sato.run(mission(plant=Stopped())).summary["stopped"] == "interrupted"


@pytest.fixture
def solve_by(monkeypatch):
    def fly(solve, **options):
        class Mine:
            def __init__(self, program, tolerance):
                self.program, library = program, load_adapters()["clarabel"]
                self.ask = library.session_factory(program, tolerance).solve

            def solve(self, b):
                return solve(self, b)

        adapter = SolverAdapter("mine", frozenset({"linear"}), False, Mine, "clarabel")
        monkeypatch.setitem(load_adapters(), "mine", adapter)
        return sato.run("crossing", overrides=CROSSING, **options)

    return fly


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda found: 1 / 0, r"Mine\.solve raised ZeroDivisionError: .*\(test_callbacks\.py:"),
        (lambda found: found.x, r"Mine\.solve: .* must be SolverResult.*, got ndarray"),
        (lambda found: found._replace(status="done"), r"Mine\.solve: .* one of"),
        (lambda found: found._replace(y=found.y[:-1]), r"Mine\.solve: .* array of shape"),
        (lambda found: found._replace(x=found.x * np.nan), r"Mine\.solve: .* finite, got nan"),
    ],
)
def test_a_solver_that_fails_is_told_once_and_counted(solve_by, spoil, said):
    with pytest.warns(UserWarning, match=said) as caught:
        run = solve_by(lambda session, b: spoil(session.ask(b)))
    assert len([each for each in caught if "Mine.solve" in str(each.message)]) == 1
    failed = run.summary["solver_errors"]
    assert failed == run.summary["solver_fallbacks"] > 0 and run.summary["reached"]
    assert sum(event["programs"] for event in run.events("solver_error")) == failed
    assert not run.summary["broken"]


def test_a_right_solver_has_no_errors_and_may_write_into_its_program(solve_by):
    def solve(session, b):
        found = session.ask(b)
        session.program.q[:] = 0.0
        session.program.A.data[:] = 1.0
        return found

    run = solve_by(lambda session, b: session.ask(b))
    assert "solver_errors" not in run.summary and run.summary["solver_fallbacks"] == 0
    assert np.array_equal(states(solve_by(solve)), states(run))


def test_strict_raises_what_a_solver_raises(solve_by):
    with pytest.raises(ZeroDivisionError):
        solve_by(lambda session, b: 1 / 0, strict=True)


def test_a_watcher_that_raises_is_told_and_the_flight_goes_on():
    def watch(mission, frame):
        frame.position.flags.writeable = True
        frame.position[:] = 7.0
        raise LookupError("no display")

    with pytest.warns(UserWarning) as caught:
        run = sato.run(mission(), progress=watch)
    first, last = (str(each.message) for each in caught)
    assert "watch raised LookupError: no display (test_callbacks.py:" in first
    assert f"raised exceptions at {len(run.recorded['time'])} instants" in last
    assert np.array_equal(states(run), states(sato.run(mission())))


def test_a_watcher_that_yields_or_is_async_is_refused():
    def watch(mission, frame):
        yield frame

    async def wait(mission, frame):
        return frame

    for late in (watch, wait):
        with pytest.raises(sato.InputError, match="a function that returns, without yield or asy"):
            sato.run(mission(), progress=late)


@pytest.mark.parametrize("scenario", [mission(), "formation6", "connectivity"])
def test_arrays_of_frames_cannot_be_written_to(scenario):
    frames = sato.simulate(scenario)
    for frame in (next(frames), next(frames)):
        for value in frame:
            if isinstance(value, np.ndarray):
                with pytest.raises(ValueError, match="read-only"):
                    value[...] = 0


def test_arrays_of_a_run_cannot_be_written_to_and_those_of_data_are_copies():
    run = sato.run(mission())
    with pytest.raises(ValueError, match="read-only"):
        run.recorded["position"][0] = 7.0
    run.data["position"][:] = 7.0
    assert run.check().kept and not run.check().broken


def test_an_agent_keeps_nothing_that_its_caller_may_write_to():
    control = []
    for spoils in (False, True):
        agent, state = sato.Agent(mission(), 0), np.array([0.0, 0, 0, 0])
        while not agent.is_finished:
            held, _ = agent.step(0.0, state, [])
            if spoils:
                state[:] = held[:] = 7.0
                state = np.zeros(4)
        control.append(agent.memory.control)
    assert np.array_equal(*control)


def test_a_stick_of_ones_own_is_checked():
    class Bent(WaypointStick):
        def command_velocity(self, time, position, waypoints_reached):
            return super().command_velocity(time, position, waypoints_reached)[:2]

    steered = sato.read("connectivity", ["run.duration_s=0.2"])
    with pytest.raises(CallbackError, match=r"Bent\.command_velocity: .*\(3,\), got \(2,\)"):
        sato.run(replace(steered, stick=Bent()))


def test_callbacks_drawn_at_random_are_told_or_right(monkeypatch):
    monkeypatch.syspath_prepend(Path(__file__).parents[1] / "scripts")
    import fuzz_callbacks

    for number in range(20):
        rng = np.random.default_rng([1, number])
        quick = [each for each in fuzz_callbacks.SUBJECTS if "linear" not in each.fly.__name__]
        subject = quick[rng.integers(len(quick))]
        ended, said = fuzz_callbacks.judge(subject, fuzz_callbacks.draw_fault(rng, subject))
        assert ended != "wrong", said
