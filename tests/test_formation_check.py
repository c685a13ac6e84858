"""Check of formation flights: an honest run passes, and every alteration is found."""

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from formation_runs import FIVE, dataset, fly

import sato
from problems.alignment import compute_shape_error
from sato.formation.check.promises import check_arrival, check_run
from sato.formation.check.recorded import FormationRecord, summarize_flight
from sato.formation.settings import FrameSettings
from sato.formation.supervisor import Phase
from sato.scenario.file import parse


@pytest.fixture(scope="module")
def honest():
    """Return data, mission and frames of a run."""
    mission, frames = fly()
    return dataset(mission, frames), mission, frames


def broken(data, mission):
    return {p.name for p in check_run(data, mission).broken}


def altered(data, name, change):
    variable = data.variables[name]
    changed = variable._replace(values=change(variable.values.copy()))
    return replace(data, variables={**data.variables, name: changed})


def with_events(data, change):
    events = [event for e in data["event"] for event in change(json.loads(str(e)))]
    text = np.array([json.dumps(event) for event in events], dtype=object)
    return altered(data, "event", lambda _: text)


def test_honest_run_keeps_all_promises(honest):
    data, mission, _ = honest
    report = check_run(data, mission)
    assert report.kept, report.broken
    assert report.summary["success"] and len(report.summary["legs"]) == 2
    assert [p.name for p in report.promises] == [
        "complete", "attributes", "times", "numbers", "alive", "component", "start", "frames",
        "drift", "formation", "gains", "flight", "speed", "climb", "acceleration",
        "climb_acceleration", "legs", "assignment", "points", "separation", "reached",
    ]  # fmt: skip


def at(index, value):
    def change(values):
        values[index] = values[index] + value
        return values

    return change


def swapped(values):
    k = len(values) // 2
    values[k:, [0, 1]] = values[k:, [1, 0]]
    return values


ALTERED = {
    "a position": ("position", at((70, 2, 1), 1e-6), "flight"),
    "the start": ("position", at((0, 2, 1), 1e-6), "start"),
    "a position of NaN": ("position", at((70, 2, 1), np.nan), "numbers"),
    "a speed": ("velocity", at((70, 2, 1), 1e-4), "flight"),
    "a speed that is too high": ("velocity", at((70, 2, 0), 2.0), "speed"),
    "a climb that is too fast": ("velocity", at((70, 2, 2), 2.0), "climb"),
    "a speed that changes too fast": ("velocity", at((70, 2, 0), 0.1), "acceleration"),
    "a climb that changes too fast": ("velocity", at((70, 2, 2), 0.1), "climb_acceleration"),
    "time": ("time", at(70, 1e-6), "times"),
    "alive": ("alive", lambda lives: ~lives, "component"),
    "component": ("component", at((70, 2), 1), "component"),
    "leg": ("leg_index", at(70, 1), "legs"),
    "all commands": ("velocity_command", lambda u: 9 + 0 * u, "legs"),
    "a command of NaN": ("velocity_command", at((70, 2, 1), np.nan), "numbers"),
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
    "names of parts of gains": ("part", lambda names: names[::-1], "gains"),
    "gains off the graph": ("gains", lambda A: A[::-1], "gains"),
}


@pytest.mark.parametrize("case", ALTERED)
def test_altered_variable_breaks_its_promise(honest, case):
    data, mission, _ = honest
    name, change, promise = ALTERED[case]
    assert promise in broken(altered(data, name, change), mission)


def drop(kind):
    return lambda event: [] if event["kind"] == kind else [event]


def shift(kind, by):
    return lambda event: [event | {"time": event["time"] + by * (event["kind"] == kind)}]


@pytest.mark.parametrize(
    ("change", "promise"),
    [
        (drop("assignment"), "assignment"),
        (shift("assignment", 0.04), "assignment"),
        (lambda e: [e | {"agents": [0]} if e["kind"] == "assignment" else e], "assignment"),
        (drop("auction"), "legs"),
        (shift("auction", 0.04), "legs"),
        (drop("leg_end"), "legs"),
        (shift("leg_end", -0.04), "legs"),
        (lambda e: [e, e] if e["kind"] == "leg_end" else [e], "legs"),
        (lambda e: [e | {"kind": "given_up"} if e["kind"] == "leg_end" else e], "legs"),
        (lambda e: [e, e | {"kind": "loss", "agents": [0]}], "alive"),
    ],
)
def test_altered_event_breaks_its_promise(honest, change, promise):
    data, mission, _ = honest
    assert promise in broken(with_events(data, change), mission)


@pytest.mark.parametrize("name", ["keep_out_m", "max_speed_m_s", "shape_m"])
def test_altered_attribute_is_found(honest, name):
    data, mission, _ = honest
    other = replace(data, attrs={**data.attrs, name: data.attrs[name] + 0.1})
    assert broken(other, mission) == {"attributes"}


def test_run_that_ends_too_early_or_too_late_is_incomplete(honest):
    _, mission, frames = honest
    assert broken(dataset(mission, frames[:-1]), mission) == {"complete"}
    late = frames[-1]._replace(time=frames[-1].time + mission.frame_period)
    assert {"complete", "legs"} <= broken(dataset(mission, [*frames, late]), mission)


@pytest.mark.parametrize("share", [0.0, 0.1, 0.4, 0.8])
def test_interrupted_run_keeps_all_other_promises(honest, share):
    _, mission, frames = honest
    some = frames[: 1 + int(share * len(frames))]
    report = check_run(dataset(mission, some, stopped="interrupted"), mission)
    assert {p.name for p in report.broken} == {"complete", "reached"}
    assert report.verdict == "not reached" and "interrupted" in report.line
    assert "interrupted" in report.broken[0].message
    assert report.summary["success"] is False
    json.dumps(report.summary, allow_nan=False)


def accumulate(mission, frames):
    """Add up the summary frame by frame, from velocities and phases."""
    total = dict.fromkeys(("time_s", "path_m", "gridlocked_s", "reassignments"), 0.0)
    for last, now in pairwise(frames):
        total["reassignments"] += sum(e["kind"] == "assignment" for e in now.events)
        is_held = last.leg_index == now.leg_index and last.phase is Phase.COMPLETED
        if now.phase is not Phase.WAITING and not is_held:
            speed = np.linalg.norm(now.velocity[:, :2], axis=1)
            total["path_m"] += float(speed.mean()) * mission.frame_period
            total["time_s"] += now.time - last.time
        if last.phase is Phase.GRIDLOCKED:
            total["gridlocked_s"] += now.time - last.time
    return total


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
def test_summary_equals_totals_added_up_in_flight(settings):
    mission, frames = fly(*settings)
    data = dataset(mission, frames)
    assert broken(data, mission) <= {"separation", "reached"}  # the paper's avoidance breaks both
    record = FormationRecord.from_data(data, mission)
    summary, total = summarize_flight(record), accumulate(mission, frames)
    for name in ("time_s", "reassignments", "gridlocked_s"):
        assert summary[name] == pytest.approx(total[name])
    # The velocities between two frames are not recorded.
    steps = mission.steps_per_frame
    turned = mission.step**2 * 2**0.5 * mission.max_acceleration * (steps - 1)
    assert abs(total["path_m"] - summary["path_m"]) <= len(frames) * turned + 1e-9
    for leg, found in enumerate(summary["legs"]):
        held = [frame for frame in frames if frame.leg_index == leg][-1]
        points = mission.gains[leg].formation.points
        expected = compute_shape_error(held.position[np.argsort(held.point_index)], points)
        assert found["shape_error_m"] == pytest.approx(expected.error)
    completed = [leg.completed for leg in record.replay.legs]
    is_close = summary["shape_error_m"] <= mission.supervision.shape_tolerance
    assert check_arrival(record).kept == (completed == [True, True] and is_close)
    rate = min(gains.convergence_rate for gains in mission.gains)
    assert summary["gains_rate"] == pytest.approx(rate)


def test_received_bytes_are_positions_and_bids_of_all_neighbors(honest):
    data, mission, frames = honest
    summary, n, radio = check_run(data, mission).summary, 5, mission.radio
    degree = [gains.formation.graph.sum() / n for gains in mission.gains]
    assert degree == [4.0, 3.6]
    positions = sum(
        degree[b.leg_index] * (3 * 32 + 8) * 50 * (b.time - a.time) for a, b in pairwise(frames)
    )
    auctions = [e for frame in frames for e in frame.events if e["kind"] == "auction"]
    bids = sum(degree[event["leg"]] * 64 * (n + 1) * event["rounds"] for event in auctions)
    assert summary["bytes_per_vehicle_s"] == pytest.approx((positions + bids) / 8 / frames[-1].time)
    longest = max(event["rounds"] for event in auctions) / radio.message_rate
    assert summary["longest_auction_s"] == pytest.approx(longest)


def test_inverted_formation_is_no_success_where_it_must_be_upright(honest):
    data, mission, frames = honest
    # The formation of the second leg is not flat.
    mirrored = [
        f._replace(position=f.position * (1, 1, -1), velocity=f.velocity * (1, 1, -1))
        for f in frames
    ]
    upright = check_run(dataset(mission, mirrored), mission).summary["legs"]
    assert upright[1]["inverted"] and not upright[1]["success"]
    assert upright[1]["shape_error_m"] < 0.1
    either = replace(mission, control_law=mission.control_law._replace(upright=False))
    assert check_run(dataset(either, mirrored), either).summary["legs"][1]["success"]
    assert not check_run(data, mission).summary["legs"][1]["inverted"]


def test_leg_with_one_point_for_two_has_no_shape_error(honest):
    data, mission, _ = honest
    [first, _] = check_run(altered(data, "point_index", lambda p: 0 * p), mission).summary["legs"]
    assert "shape_error_m" not in first and first["success"] is False


def test_success_needs_a_shape_error_within_the_tolerance(honest):
    data, mission, _ = honest
    error = check_run(data, mission).summary["shape_error_m"]
    strict = mission.supervision._replace(shape_tolerance=error * (1 - 1e-9))
    assert not check_run(data, replace(mission, supervision=strict)).summary["success"]


def test_agent_commanded_into_others_keeps_out_of_them():
    push = "push=[{vehicle=0, start_s=1, end_s=30, velocity_m_s=[0.4, 0, 0]}]"
    mission, frames = fly(push)
    assert any(frame.avoiding[0] for frame in frames)
    report = check_run(dataset(mission, frames), mission)
    assert report.kept, report.broken


@pytest.mark.parametrize(("noise", "allowance"), [(0.0, 0.0), (0.01, 0.025), (0.1, 0.05)])
def test_separation_may_lack_what_noise_explains_alone(honest, noise, allowance):
    data, mission, _ = honest
    noisy = replace(mission, frames=replace(mission.frames, noise=noise))
    [near] = [p for p in check_run(data, noisy).promises if p.name == "separation"]
    assert near.tolerance == pytest.approx(mission.keep_out * (1 - 1e-9) - allowance, rel=1e-12)
    assert ("for noise" in near.message) == (noise > 0)


def test_vehicles_at_the_least_distance_keep_it_despite_rounding():
    row = 1.2 * np.column_stack([np.arange(4), np.zeros(4)])  # two are 1.1999999999999997 m apart
    mission = sato.Formation(
        start=row, legs=[sato.FormationLeg(sato.Ring(radius=2.0))], frames=FrameSettings(noise=0.0)
    )
    assert sato.run(mission).verdict == "kept"


def test_legacy_agents_that_meet_break_separation_alone():
    # The paper's avoidance, for agents without an assignment that must cross each other.
    mission, frames = fly("legacy_avoidance=true", "assignment.kind=none", seed=1)
    report = check_run(dataset(mission, frames), mission)
    near = next(p for p in report.promises if p.name == "separation")
    assert near.value == report.summary["min_separation_m"] < 1.15
    assert {p.name for p in report.broken} == {"separation", "reached"}
    i, j = near.agents
    k = int(np.searchsorted([frame.time for frame in frames], near.time))
    apart = [np.linalg.norm(np.subtract(*f.position[[i, j], :2])) for f in frames[k - 1 : k + 1]]
    assert min(apart) == pytest.approx(near.value, abs=0.02)
    assert report.line.startswith(f"BROKEN: separation, {near.value:.4g} m < 1.175 m, the keep-out")
    assert report.line.endswith(f"agents {i} and {j} at {round(near.time, 3):g} s")


def test_altered_avoidance_of_a_legacy_flight_breaks_its_gridlocks():
    mission, frames = fly("legacy_avoidance=true", "assignment.kind=none", seed=1)
    data = altered(dataset(mission, frames), "avoiding", lambda avoids: avoids | True)
    assert "legs" in broken(data, mission)


def test_saved_run_is_checked_from_its_own_scenario(tmp_path):
    run = sato.run(parse(FIVE), seed=2)
    assert run.check().kept and run.summary["success"]
    run.save(tmp_path)
    again = sato.load(tmp_path)
    assert again.check().kept
    assert again.summary == run.summary
    wrong = replace(again, claimed=again.summary | {"path_m": again.summary["path_m"] + 1})
    assert {p.name for p in wrong.check().broken} == {"summary"}
    moved = replace(again, recorded=altered(again.recorded, "position", at((70, 2, 1), 1e-6)))
    assert {"unaltered", "flight"} <= {p.name for p in moved.check().broken}


def test_replay_gives_the_phases_and_legs_of_the_flight(honest):
    data, mission, frames = honest
    record = FormationRecord.from_data(data, mission)
    assert list(record.replay.phase) == [frame.phase for frame in frames]
    assert record.replay.leg.tolist() == [frame.leg_index for frame in frames]
    assert [leg.leg for leg in record.replay.legs] == [0, 1]
    assert all(leg.completed for leg in record.replay.legs)
