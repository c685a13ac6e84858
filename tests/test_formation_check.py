"""The judge of formation flights: an honest run passes, and one altered anywhere does not."""

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from recorded_run import record_run

import sato
from sato.formation import OperatorCommand, simulate
from sato.formation.check import FormationRecord, check_run
from sato.formation.check.closest import find_closest_approach
from sato.formation.system import SYSTEM
from sato.formation.trial import evaluate_trial
from sato.former import parse

FIVE = """
system = "formation"
name = "five"

[swarm]
agents = 5
start = { kind = "random", box_m = [7, 7], separation_m = 1.5 }

[protocol]
hover_s = 1.0
limit_s = 60.0

[[leg]]
formation = { kind = "library", name = "swarm5/Pentagon" }

[[leg]]
formation = { kind = "random", box_m = [6, 6, 2], separation_m = 2 }
graph = { kind = "thinned", removals = 1 }
"""


def flown(*settings, seed=2, **changed):
    """A run, the mission, and its frames."""
    rng = np.random.default_rng(seed)
    mission = replace(parse(FIVE, settings).build(rng), **changed)
    frames = list(simulate(mission, rng))
    return run_of(mission, frames), mission, frames


def run_of(mission, frames, **attributes):
    return record_run(SYSTEM, frames, mission, **attributes)


def broken(run, mission):
    return {p.name for p in check_run(run.data, mission).broken}


def altered(run, name, change):
    """The run with one variable changed."""
    was = run.data[name]
    changed = (was.dims, change(was.values.copy()), was.attrs)
    return replace(run, data=run.data.assign({name: changed}))


def retold(run, change):
    """The run with other events."""
    told = [event for e in run.data["event"].values for event in change(json.loads(str(e)))]
    text = np.array([json.dumps(event) for event in told], dtype=object)
    data = run.data.drop_vars("event")
    return replace(run, data=data.assign(event=("event", text)))


@pytest.fixture(scope="module")
def honest():
    return flown()


def test_an_honest_run_keeps_what_it_promises(honest):
    run, mission, _ = honest
    report = check_run(run.data, mission)
    assert report.kept, report.broken
    assert report.summary["success"] and len(report.summary["legs"]) == 2
    assert [p.name for p in report.promises] == [
        "complete", "attributes", "times", "numbers", "alive", "component", "start", "frames",
        "drift", "formation", "gains", "flight", "speed", "climb", "acceleration",
        "climb_acceleration", "legs", "assignment", "points", "separation",
    ]  # fmt: skip


def at(index, value):
    def change(values):
        values[index] = values[index] + value
        return values

    return change


def swapped(values):
    # Two vehicles exchange their points in the middle of it.
    k = len(values) // 2
    values[k:, [0, 1]] = values[k:, [1, 0]]
    return values


ALTERED = {
    "a place": ("position", at((70, 2, 1), 1e-6), "flight"),
    "the start": ("position", at((0, 2, 1), 1e-6), "start"),
    "a place that is none": ("position", at((70, 2, 1), np.nan), "numbers"),
    "a speed": ("velocity", at((70, 2, 1), 1e-4), "flight"),
    "a speed that is too high": ("velocity", at((70, 2, 0), 2.0), "speed"),
    "a climb that is too fast": ("velocity", at((70, 2, 2), 2.0), "climb"),
    "a speed that changes too fast": ("velocity", at((70, 2, 0), 0.1), "acceleration"),
    "a climb that changes too fast": ("velocity", at((70, 2, 2), 0.1), "climb_acceleration"),
    "time": ("time", at(70, 1e-6), "times"),
    "who is there": ("alive", lambda lives: ~lives, "component"),
    "the network": ("component", at((70, 2), 1), "component"),
    "the leg": ("leg_index", at(70, 1), "legs"),
    "all commands": ("velocity_command", lambda u: 9 + 0 * u, "legs"),
    "a command that is none": ("velocity_command", at((70, 2, 1), np.nan), "numbers"),
    "the avoidance": ("avoiding", lambda avoids: avoids | True, "legs"),
    "a point": ("point_index", at((70, 2), 1), "assignment"),
    "two points": ("point_index", swapped, "assignment"),
    "a point for two": ("point_index", lambda p: 0 * p, "points"),
    "a heading": ("frame_yaw", at(2, 1e-6), "frames"),
    "an origin": ("frame_offset", at((2, 0), 1e-6), "frames"),
    "a drift": ("frame_drift", at((70, 2, 1), 1e-6), "drift"),
    "a drift from the start": ("frame_drift", lambda d: d + 1e-6, "drift"),
    "a formation": ("formation", at((0, 2, 1), 1e-6), "formation"),
    "a graph": ("graph", lambda edges: edges | True, "formation"),
    "gains": ("gains", at((0, 0, 2, 1), 1e-9), "gains"),
    "gains of another shape": ("gains", at((0, 0, 2, 1), 0.1), "gains"),
    "gains that drive apart": ("gains", lambda A: -A, "gains"),
    "gains off the graph": ("gains", lambda A: A[::-1], "gains"),
}


@pytest.mark.parametrize("case", ALTERED)
def test_an_alteration_breaks_the_promise_that_it_concerns(honest, case):
    run, mission, _ = honest
    name, change, promise = ALTERED[case]
    assert promise in broken(altered(run, name, change), mission)


def drop(kind):
    return lambda event: [] if event["kind"] == kind else [event]


def shifted(kind, by):
    return lambda event: [event | {"time": event["time"] + by * (event["kind"] == kind)}]


@pytest.mark.parametrize(
    ("change", "promise"),
    [
        (drop("assignment"), "assignment"),
        (shifted("assignment", 0.04), "assignment"),
        (lambda e: [e | {"agents": [0]} if e["kind"] == "assignment" else e], "assignment"),
        (drop("auction"), "legs"),
        (shifted("auction", 0.04), "legs"),
        (drop("leg_end"), "legs"),
        (shifted("leg_end", -0.04), "legs"),
        (lambda e: [e, e] if e["kind"] == "leg_end" else [e], "legs"),
        (lambda e: [e | {"kind": "given_up"} if e["kind"] == "leg_end" else e], "legs"),
        (lambda e: [e, e | {"kind": "loss", "agents": [0]}], "alive"),
    ],
)
def test_events_are_those_that_had_to_be(honest, change, promise):
    run, mission, _ = honest
    assert promise in broken(retold(run, change), mission)


@pytest.mark.parametrize("name", ["keep_out_m", "max_speed_m_s", "shape_m"])
def test_radii_and_limits_are_the_scenarios(honest, name):
    run, mission, _ = honest
    data = run.data.copy()
    data.attrs[name] = data.attrs[name] + 0.1
    assert broken(replace(run, data=data), mission) == {"attributes"}


def test_a_run_that_ends_too_soon_or_too_late_says_so(honest):
    _, mission, frames = honest
    assert broken(run_of(mission, frames[:-1]), mission) == {"complete"}
    late = frames[-1]._replace(time=frames[-1].time + mission.frame_period)
    assert {"complete", "legs"} <= broken(run_of(mission, [*frames, late]), mission)


@pytest.mark.parametrize("share", [0.0, 0.1, 0.4, 0.8])
def test_an_interrupted_run_is_whole_up_to_there_but_no_success(honest, share):
    _, mission, frames = honest
    some = frames[: 1 + int(share * len(frames))]
    report = check_run(run_of(mission, some, stopped="interrupted").data, mission)
    assert {p.name for p in report.broken} == {"complete"}
    assert "interrupted" in report.broken[0].message
    assert report.summary["success"] is False
    json.dumps(report.summary, allow_nan=False)


@pytest.mark.parametrize(
    "settings",
    [
        [],
        ["assignment.kind=cbaa", "radio.loss=0.2", "radio.delay_s=0.04"],
        ["assignment.kind=none"],
        ["assignment.kind=hungarian", "legacy_avoidance=true", "protocol.settled_m_s=0.3"],
        ["limit_s=3"],
    ],
)
def test_the_summary_is_what_an_account_kept_in_flight_says(settings):
    run, mission, frames = flown(*settings)
    said, trial = check_run(run.data, mission).summary, evaluate_trial(mission, frames)
    assert said["time_s"] == pytest.approx(trial.time)
    # Where control steps are finer than instants, the way between them is not on file.
    bent = mission.control_step**2 * 2**0.5 * mission.limits.acceleration * (mission.every - 1)
    assert -1e-9 <= trial.path_length - said["path_m"] <= len(frames) * bent + 1e-9
    assert said["reassignments"] == trial.assignments
    assert said["gridlocked_s"] == pytest.approx(trial.gridlock_time)
    step_of_both = 2 * mission.limits.speed * mission.frame_period
    assert -1e-6 <= trial.min_separation - said["min_separation_m"] <= step_of_both
    assert [leg["shape_error_m"] for leg in said["legs"]][: len(trial.shape_errors)] == [
        pytest.approx(like.error) for like in trial.shape_errors
    ]
    if trial.completed:
        assert said["shape_error_m"] == pytest.approx(trial.shape_error)
        assert said["success"] == (trial.shape_error <= mission.protocol.shape)
    else:
        assert not said["success"]
    assert said["gains_rate"] == pytest.approx(min(g.rate for g in mission.gains))


def test_what_is_received_is_told_to_each_neighbour_in_positions_and_books(honest):
    run, mission, frames = honest
    n, radio = 5, mission.radio
    degree = [gains.formation.graph.sum() / n for gains in mission.gains]
    assert degree == [4.0, 3.6]
    positions = sum(
        degree[b.leg_index] * (3 * 32 + 8) * 50 * (b.time - a.time) for a, b in pairwise(frames)
    )
    books = sum(
        degree[event["leg"]] * 64 * (n + 1) * event["rounds"] for event in run.events("auction")
    )
    said = check_run(run.data, mission).summary
    assert said["bytes_per_vehicle_s"] == pytest.approx((positions + books) / 8 / frames[-1].time)
    most = max(event["rounds"] for event in run.events("auction"))
    assert said["longest_auction_s"] == pytest.approx(most / radio.rate)


def test_a_shape_upside_down_is_recognised_and_none_where_it_must_be_upright(honest):
    run, mission, frames = honest
    # All is mirrored, in the second leg and after, where the formation is not flat.
    mirrored = [
        f._replace(position=f.position * (1, 1, -1), velocity=f.velocity * (1, 1, -1))
        for f in frames
    ]
    upright = check_run(run_of(mission, mirrored).data, mission).summary["legs"]
    assert upright[1]["inverted"] and not upright[1]["success"]
    assert upright[1]["shape_error_m"] < 0.1
    either = replace(mission, control_law=mission.control_law._replace(upright=False))
    assert check_run(run_of(either, mirrored).data, either).summary["legs"][1]["success"]
    assert not check_run(run.data, mission).summary["legs"][1]["inverted"]


def test_a_shape_that_two_claim_a_point_of_has_no_error_and_is_none(honest):
    run, mission, _ = honest
    claimed = altered(run, "point_index", lambda p: 0 * p)
    [first, _] = check_run(claimed.data, mission).summary["legs"]
    assert "shape_error_m" not in first and first["success"] is False


def test_a_shape_counts_as_far_as_the_protocol_allows(honest):
    run, mission, _ = honest
    said = check_run(run.data, mission).summary
    strict = mission.supervision._replace(shape=said["shape_error_m"] * (1 - 1e-9))
    assert not check_run(run.data, replace(mission, protocol=strict)).summary["success"]


def test_whoever_is_pushed_into_others_is_kept_away_from_them():
    push = OperatorCommand(0, 1.0, 30.0, np.array([0.4, 0.0, 0.0]))
    run, mission, _ = flown(operator_commands=(push,))
    report = check_run(run.data, mission)
    assert report.kept, report.broken


def test_vehicles_that_meet_break_the_separation_and_nothing_else():
    # By the printed code, in which those without an assignment fly through each other's places.
    run, mission, _ = flown("legacy_avoidance=true", "assignment.kind=none", seed=1)
    report = check_run(run.data, mission)
    near = next(p for p in report.promises if p.name == "separation")
    assert near.value == report.summary["min_separation_m"] < 1.15
    assert {p.name for p in report.broken} == {"separation"}
    assert "1.2 m" in near.message


def test_the_nearest_is_found_also_between_instants(rng):
    path = np.array([[[0.0, 0.0], [1.0, 0.1]], [[1.0, 0.0], [0.0, 0.1]]])
    assert find_closest_approach(path).distance == pytest.approx(0.1)
    assert find_closest_approach(path)[1:] == (0, (0, 1))
    assert find_closest_approach(path[:1]).distance == pytest.approx(np.hypot(1, 0.1))
    many = rng.uniform(0, 9, (6, 7, 2))
    s = np.linspace(0, 1, 2001)[:, None, None]
    fine = np.concatenate([a + s * (b - a) for a, b in pairwise(many)])
    apart = np.linalg.norm(fine[:, :, None] - fine[:, None], axis=3)
    apart[:, range(7), range(7)] = np.inf
    found = find_closest_approach(many)
    assert found.distance <= apart.min() <= found.distance + 0.01
    _, i, j = np.unravel_index(apart.argmin(), apart.shape)
    assert found.pair == tuple(sorted((i, j)))
    assert find_closest_approach(many[:, :1]).distance == np.inf


def test_a_run_of_a_scenario_is_judged_from_its_own_text(tmp_path):
    run = sato.run(parse(FIVE), seed=2)
    assert run.check().kept and run.summary["success"]
    run.save(tmp_path)
    again = sato.load(tmp_path)
    assert again.check().kept
    assert again.summary == run.summary
    for word in ("path_m", "bytes_per_vehicle_s", "gridlocked_s", "gains_rate"):
        wrong = replace(again, summary=again.summary | {word: again.summary[word] + 1})
        assert {p.name for p in wrong.check().broken} == {"summary"}
    moved = altered(again, "position", at((70, 2, 1), 1e-6))
    assert {"unaltered", "flight"} <= {p.name for p in moved.check().broken}


def test_what_is_read_of_a_run_is_what_was_flown(honest):
    run, mission, frames = honest
    evidence = FormationRecord.from_dataset(run.data, mission)
    phases = [frame.phase for frame in frames]
    assert list(evidence.replay.phase) == phases
    assert evidence.replay.leg.tolist() == [frame.leg_index for frame in frames]
    assert [s.leg for s in evidence.replay.legs] == [0, 1]
    assert all(s.completed for s in evidence.replay.legs)
    for leg, gains in enumerate(mission.gains):
        assert evidence.load_gains(leg).convergence_rate == gains.convergence_rate
