"""Scenario files: units, overrides, files beside them, and refusals with values that would do."""

import re
import tomllib
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Annotated

import numpy as np
import pytest
import test_cli
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from scipy.spatial.distance import pdist

from dynamics.units import SUFFIXES, Unit
from sato.network.graph import CommunicationGraph
from sato.reconfiguration.feasibility import is_detectable, target_demand
from sato.reconfiguration.leg import Loss
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.reach import check_reach
from sato.scenario.definition import Definition, fields_of
from sato.scenario.errors import InputError, ScenarioError, round_down, round_up
from sato.scenario.file import BUILT_IN, parse, read, scenarios
from sato.scenario.table import read_table

RECONFIGURATIONS = [
    name for name in scenarios() if "formation" not in name and name != "connectivity"
]

TINY = f"""{test_cli.TINY}
[[leg]]
shape = {{ kind = "lattice", spacing_m = 1.5 }}
steps = 20
"""


def tiny(*overrides: str) -> Reconfiguration:
    return parse(TINY, overrides)


def drawn(*overrides: str) -> Reconfiguration:
    return tiny(*overrides).draw(np.random.default_rng(0))


def drawn_from(name: str, *overrides: str, seed: int = 0) -> Reconfiguration:
    return read(name, overrides).draw(np.random.default_rng(seed))


def refusal(*overrides: str) -> str:
    with pytest.raises((ScenarioError, InputError)) as caught:
        drawn(*overrides)
    return str(caught.value)


# Units.


@dataclass(frozen=True, eq=False, repr=False)
class Measured(Definition):
    """One number of each unit."""

    length: Annotated[float, Unit("m")] = 0.0
    speed: Annotated[float, Unit("m_s")] = 0.0
    acceleration: Annotated[float, Unit("m_s2")] = 0.0
    time: Annotated[float, Unit("s")] = 0.0
    angle: Annotated[float, Unit("rad")] = 0.0
    angular_rate: Annotated[float, Unit("rad_s")] = 0.0
    frequency: Annotated[float, Unit("hz")] = 0.0
    density: Annotated[float, Unit("kg_m3")] = 0.0
    gravitational_parameter: Annotated[float, Unit("m3_s2")] = 0.0
    strength_of_the_oblateness: Annotated[float, Unit("m5_s2")] = 0.0


FIELDS = {
    quantity: quantity.replace(" ", "_")
    for quantity in {suffix.quantity for suffix in SUFFIXES.values()}
    if quantity.replace(" ", "_") in {field.name for field in fields_of(Measured)}
}
SI = {suffix.quantity: name for name, suffix in SUFFIXES.items() if suffix.factor == 1.0}
KNOWN = [name for name, suffix in SUFFIXES.items() if suffix.quantity in FIELDS]


@given(st.sampled_from(KNOWN), st.floats(-1e6, 1e6).filter(lambda x: not 0 < abs(x) < 1e-20))
def test_number_in_any_unit_of_its_quantity_becomes_si(name, value):
    field = FIELDS[SUFFIXES[name].quantity]
    measured = read_table(Measured, {f"{field}_{name}": value})
    assert getattr(measured, field) == value * SUFFIXES[name].factor


@given(st.sampled_from(KNOWN), st.sampled_from(list(FIELDS)))
def test_unit_of_another_quantity_is_refused_with_the_right_key(name, quantity):
    if SUFFIXES[name].quantity != quantity:
        with pytest.raises(InputError, match=f"write {FIELDS[quantity]}_{SI[quantity]}$"):
            read_table(Measured, {f"{FIELDS[quantity]}_{name}": 1.0})


def test_units_have_their_sizes():
    sizes = {
        "km3_s2": 1e9,
        "km": 1000.0,
        "min": 60.0,
        "mm_s": 0.001,
        "mm_s2": 0.001,
        "deg": np.pi / 180,
    }
    found = {name: SUFFIXES[name].factor for name in sizes}
    assert found == pytest.approx(sizes, rel=1e-15)


def test_lists_of_numbers_have_units():
    start = tiny("start.positions_km=[[0,0],[1,0],[2,-3]]").start
    np.testing.assert_array_equal(start.positions, [[0, 0], [1000, 0], [2000, -3000]])


def test_quantity_given_twice_is_refused():
    text = TINY.replace("comm_radius_m = 5.0", "comm_radius_m = 5.0\ncomm_radius_km = 0.005")
    with pytest.raises(ScenarioError, match=r"swarm\.comm_radius_km: is given twice"):
        parse(text)


# Missions.


@pytest.mark.parametrize("name", sorted(RECONFIGURATIONS))
def test_built_in_scenario_is_described_drawn_and_read_from_its_own_text(name):
    mission = read(name)
    mission.draw(np.random.default_rng(0))
    again = parse(mission.to_toml())
    assert again == mission == read(BUILT_IN / f"{name}.toml")
    assert again.to_toml() == mission.to_toml()
    assert len(scenarios()[name]) > 20


@pytest.mark.parametrize("seed", range(5))
def test_uiuc_starts_separated_at_rest_in_several_components(seed):
    mission = drawn_from("uiuc", seed=seed)
    position, velocity = np.split(mission.initial_states, 2, axis=1)
    assert position.shape == (123, 2) and not velocity.any()
    assert pdist(position).min() >= 0.8
    assert np.abs(position).max() <= 29.0 / 2
    network = CommunicationGraph.from_positions(position, mission.comm_radius, mission.alive)
    assert network.component.max() + 1 >= 5
    assert np.array_equal(position, drawn_from("uiuc", seed=seed).initial_states[:, :2])
    assert not np.array_equal(position, drawn_from("uiuc", seed=seed + 1).initial_states[:, :2])


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("agents", [1, 10, 100])
def test_default_box_gives_a_connected_graph(dimension, agents):
    mission = drawn_from("random", f"dimension={dimension}", f"agents={agents}", seed=1)
    assert mission.initial_states.shape == (agents, 2 * dimension)
    position = mission.initial_states[:, :dimension]
    network = CommunicationGraph.from_positions(position, mission.comm_radius, mission.alive)
    assert network.component.max() == 0


def test_defaults_follow_from_the_other_keys():
    mission = drawn()
    assert (mission.horizon_steps, mission.replan_steps, mission.auction_steps) == (4, 1, 4)
    assert mission.target_spacing == pytest.approx(1.5)
    assert mission.position_tolerance == pytest.approx(1.5e-6)
    assert mission.velocity_tolerance == pytest.approx(1.5e-6)
    assert [len(leg.targets) for leg in mission.legs] == [3, 3]
    assert mission.epsilon == "auto"


def test_keys_reach_the_mission():
    expected = {
        "replan_steps=2": ("replan_steps", 2),
        "auction_steps=4": ("auction_steps", 4),
        "epsilon=0.5": ("epsilon", 0.5),
        "tie_break=0.1": ("tie_break", 0.1),
        "cost=distance": ("cost", "distance"),
        "ids=false": ("bidder_ids", False),
        "believed=2": ("target_count", 2),
        "position_tolerance_m=0.01": ("position_tolerance", 0.01),
        "velocity_tolerance_m_s=0.02": ("velocity_tolerance", 0.02),
        "disturbance.acceleration_mm_s2=1": ("disturbance", 1e-3),
        "disturbance.position_m=0.1": ("position_noise", 0.1),
        "disturbance.velocity_m_s=0.2": ("velocity_noise", 0.2),
        "margin_m=0.0": ("margin", 0.0),
        "control_norm=2": ("control_norm", 2),
        'fuel_norm="inf"': ("fuel_norm", "inf"),
    }
    losses = "[{kind='agents',agents=[1]},{kind='random',share=0.3,at_step=5}]"
    last = ("leg.1.lose={kind='middle',share=0.5}", "leg.1.recount=true")
    mission = drawn(*expected, f"leg.0.lose={losses}", *last)
    for name, value in expected.values():
        assert getattr(mission, name) == value, name
    assert mission.legs[0].losses == (Loss("agents", agents=(1,)), Loss("random", 0.3, at_step=5))
    assert (mission.legs[1].losses, mission.legs[1].recount) == ((Loss("middle", 0.5),), True)


def test_single_target_has_a_tolerance():
    mission = drawn("agents=1", "positions_m=[[0,0]]", "shape.spacing_m=1")
    assert mission.position_tolerance == pytest.approx(0.5e-6)
    assert mission.epsilon == pytest.approx(0.2 * 0.5**2 / 2)


def test_rings_are_flat_in_space_and_lattices_fill_it():
    space = "model.dimension=3"
    start = "positions_m=[[0,0,1],[2,0,-1],[4,0,0]]"
    mission = drawn(space, start, "leg.0.shape.center_m=[1,2,3]")
    ring, ball = (leg.targets[:, :3] for leg in mission.legs)
    np.testing.assert_array_equal(ring[:, 2], 3.0)
    np.testing.assert_allclose(ring.mean(axis=0), [1, 2, 3])
    assert drawn_from("random3d").legs[0].targets[:, 2].any()
    assert not drawn_from("random3d", "flat=true").legs[0].targets[:, 2].any()
    assert ball.shape == (3, 3)


@pytest.mark.parametrize(
    ("center", "expected"),
    [([], [1.0, 3.0, 5.0]), (["leg.0.shape.center_m=[0,0]"], [-2.0, 0.0, 2.0])],
)
def test_points_stay_where_they_are_unless_centered(center, expected):
    points = "leg.0.shape={kind='points',positions_m=[[1,1],[3,1],[5,1]]}"
    found = drawn(points, *center).legs[0].targets[:, 0]
    np.testing.assert_allclose(np.sort(found), expected, atol=1e-12)


# Losses and joins.


def test_joining_agents_start_clear_of_the_others():
    join = "{agents=5,start={kind='random',box_m=8,separation_m=0.6}}"
    mission = drawn(f"leg.1.join={join}", "leg.1.steps=60")
    assert mission.alive.tolist() == [True] * 3 + [False] * 5
    assert mission.joining(1) == [([3, 4, 5, 6, 7], 0)]
    there = mission.legs[0].targets[:, :2]
    assert pdist(np.concatenate([there, mission.initial_states[3:, :2]])).min() >= 0.5
    assert len(mission.legs[1].targets) == 8


def test_joining_on_top_of_another_agent_is_refused():
    join = "leg.0.join={agents=1,start={kind='points',positions_m=[[2.1,0]]},room='refuse'}"
    assert "leg.0.join.0.start: agent 3 starts 0.1 m from an agent that is there" in refusal(join)


JOINS_LATE = "leg.0.join={agents=2,start={kind='lattice',spacing_m=9},at_step=1}"
FIRST_IS_LOST = "lose={kind='agents',agents=[0]}"
RECOUNT = "leg.1.recount=true"


@pytest.mark.parametrize(
    ("overrides", "expected"),
    [
        ([], [3, 3]),
        (["believed=5"], [5, 5]),
        (["believed=2"], [3, 3]),
        (["believed=5", RECOUNT], [5, 3]),
        (["leg.1.lose={kind='agents',agents=[0,2]}"], [3, 3]),
        ([f"leg.0.{FIRST_IS_LOST}"], [3, 3]),
        ([f"leg.0.{FIRST_IS_LOST}", RECOUNT], [3, 2]),
        ([f"leg.0.{FIRST_IS_LOST}", f"leg.1.{FIRST_IS_LOST}", RECOUNT], [3, 2]),
        (["leg.0.lose={kind='random',share=0.4}", RECOUNT], [3, 2]),
        (["leg.0.lose={kind='agents',agents=[0],at_step=3}", RECOUNT], [3, 3]),
        (["leg.1.join={agents=2,start={kind='lattice',spacing_m=9}}"], [3, 5]),
        ([JOINS_LATE, "leg.0.lose={kind='middle',share=0.4}"], [4, 4]),
        ([JOINS_LATE, "leg.0.lose={kind='agents',agents=[3],at_step=2}"], [5, 5]),
    ],
)
def test_target_demand_follows_losses_and_joins(overrides, expected):
    assert list(target_demand(tiny(*overrides))) == expected


# Files beside a scenario.


def test_files_beside_a_scenario_are_written_into_it(tmp_path, monkeypatch):
    folder = tmp_path / "beside"
    folder.mkdir()
    (folder / "starts.csv").write_text("0,0\n2,0\n4,1\n")
    (folder / "points.csv").write_text("x_m,y_m\n0,0\n2.5,0.1\n5,0\n7.5,0.3\n")
    Image.new("L", (30, 20), 0).save(folder / "black.png")
    text = TINY.replace("positions_m = [[0.0, 0.0], [2.0, 0.0], [4.0, 0.0]]", 'file = "starts.csv"')
    text = text.replace('kind = "ring"', 'kind = "points", file = "points.csv"')
    text = text.replace('kind = "lattice"', 'kind = "picture", file = "black.png"')
    (folder / "mine.toml").write_text(text)
    monkeypatch.chdir(tmp_path)
    scenario = read("beside/mine.toml", ["leg.0.steps=30", "leg.1.shape.center_m=[3,4]"])
    alone = scenario.to_toml()
    assert "file" not in alone
    mission, again = (one.draw(np.random.default_rng(0)) for one in (scenario, parse(alone)))
    np.testing.assert_array_equal(mission.initial_states[:, :2], [[0, 0], [2, 0], [4, 1]])
    np.testing.assert_array_equal(again.initial_states, mission.initial_states)
    for one, other in zip(mission.legs, again.legs, strict=True):
        np.testing.assert_array_equal(one.targets, other.targets)


def test_text_is_written_as_points_where_it_is_in_a_font():
    plain, points = (
        tomllib.loads(tiny(f"leg.0.shape={{kind='text',text='I',spacing_m=1{font}}}").to_toml())
        for font in ("", ",font='DejaVu Serif'")
    )
    assert points["leg"][0]["shape"]["kind"] == "points"
    assert plain["leg"][0]["shape"] == {"kind": "text", "text": "I", "spacing_m": 1.0}


# Overrides.


@pytest.mark.parametrize(
    ("settings", "key", "values"),
    [
        (["steps=33"], "steps", [33, 33]),
        (["leg.1.steps=33"], "steps", [20, 33]),
        (["leg.steps=33"], "steps", [33, 33]),
        (["leg.shape.spacing_m=3"], "shape.spacing", [3.0, 3.0]),
        (["shape.spacing_km=0.003", "leg.0.shape.spacing_m=2"], "shape.spacing", [2.0, 3.0]),
        (["leg.shape.radius_m=3", "leg.0.shape.radius_m=4"], "shape.radius", [4.0, 3.0]),
    ],
)
def test_override_is_of_one_leg_by_number_or_of_all(settings, key, values):
    assert list(map(attrgetter(key), tiny(*settings).legs)) == values


def test_override_changes_only_the_legs_that_have_the_key():
    changed = read("uiuc", ["share=0.1"])
    assert [[loss.share for loss in leg.losses] for leg in changed.legs] == [[], [], [0.1], []]


def test_override_reaches_tables_that_are_given_or_not():
    assert tiny("comm_radius_km=0.007").comm_radius == 7.0
    assert tiny("disturbance.position_m=0.1").position_noise == 0.1
    assert tiny("disturbance={position_m=0.1}").position_noise == 0.1
    assert tiny("start={kind='random',box_m=9,separation_m=0.6}", "box_m=12").start.box == 12.0


@pytest.mark.parametrize("written", ['"A = B"', "A = B", "A\nb = 1"])
def test_text_in_an_override_needs_no_quotes(written):
    shape = "leg.0.shape={kind='text',text='I',spacing_m=1}"
    assert tiny(shape, f"text={written}").legs[0].shape.text == written.strip('"')


# Refusals, and their proposed cures.


CURE = r"([a-z_]+\.[a-z_0-9]+ = [-.\de]+|plan\.allow_undetectable = true)"
BROKEN = ("comm_radius_m=3", "max_speed_m_s=0.777", "horizon_steps=9", "step_s=1.7")


@pytest.mark.parametrize(
    "broken", [*((one,) for one in BROKEN), ("collision_radius_m=0.9", "comm_radius_m=1.3")]
)
def test_every_proposed_cure_for_proposition_9_works(broken):
    said = refusal(*broken)
    found = re.findall(CURE, said)
    assert len(found) >= 3, said
    for cure in found:
        key, value = cure.split(" = ")
        shorter = ["replan_steps=1", "auction_steps=1"] if "horizon" in key else []
        scenario = tiny(*broken, *shorter, f"{key}={value}")
        assert is_detectable(scenario) == ("allow" not in cure), cure


def test_proposition_9_holds_with_equality():
    assert is_detectable(tiny("comm_radius_m=4.5"))
    assert "Proposition 9" in refusal("comm_radius_m=4.4999")


def test_unlimited_speed_is_undetectable():
    text = TINY.replace("max_speed_m_s = 0.5\n", "")
    with pytest.raises(ScenarioError, match=r"no model\.max_speed_m_s.*max_speed_m_s = 0\.5625"):
        parse(text)
    assert not is_detectable(parse(text, ["allow_undetectable=true"]))


def test_proposed_steps_are_the_fewest_that_suffice():
    said = refusal("leg.0.steps=2")
    enough = int(re.search(r"steps = (\d+) would do", said)[1])
    drawn(f"leg.0.steps={enough}")
    assert f"in {enough - 1} steps" in refusal(f"leg.0.steps={enough - 1}")


def test_reach_needs_a_target_for_every_agent():
    # Both can reach the first target in time, and neither the second.
    mission = drawn(
        "agents=2",
        "positions_m=[[-0.6,0],[0.6,0]]",
        "leg.0.shape={kind='points',positions_m=[[0,0],[0,90]],keep_order=true}",
        "leg.0.steps=400",
        "leg.1.steps=400",
    )
    hurried = replace(mission, legs=(replace(mission.legs[0], steps=30),))
    with pytest.raises(InputError, match=r"agent \d is left without a target"):
        check_reach(hurried)


def test_agent_lost_before_the_start_needs_no_target():
    near = "positions_m=[[0,0],[2,0],[400,0]]"
    assert "agent 2 can reach none" in refusal(near)
    drawn(near, "leg.0.lose={kind='agents',agents=[2]}")
    drawn(near, "leg.0.lose={kind='random',share=0.4}")
    assert "agent 2 can reach none" in refusal(near, "leg.0.lose={kind='random',share=0.1}")


def test_speed_limit_puts_targets_out_of_reach():
    far = "leg.0.shape.center_m=[30,0]"
    drawn(far, "leg.0.steps=80", "leg.1.steps=80")
    assert "steps = " in refusal(far, "leg.0.steps=50", "leg.1.steps=80")


@pytest.mark.parametrize("kind", ["ring", "lattice"])
def test_proposed_radius_suffices(kind):
    shape = f"leg.0.shape={{kind='{kind}',radius_m=0.1}}"
    said = refusal("agents=3", shape)
    enough = re.search(r"radius of ([\d.]+) m,? ", said.split("apart")[1])[1]
    drawn(shape, f"leg.0.shape.radius_m={enough}")


def test_proposed_box_suffices():
    start = "start={kind='random',box_m=3,separation_m=0.8}"
    more = ("agents=40", "leg.steps=60")
    enough = re.search(r"box_m = ([\d.]+) would do", refusal(start, *more))[1]
    drawn(start, *more, f"box_m={enough}")


def test_more_components_than_possible_are_refused():
    start = "start={kind='random',box_m=3,separation_m=0.8,min_components=3}"
    assert "none of 200 draws in a box of 3 m has 3 components" in refusal(start)
    assert "asks for 1" in refusal(f"{start[:-1]},connected=true}}")
    assert "is 3, and there are 2 agents; 2 or less would do" in refusal(start, "agents=2")


@given(st.floats(1e-6, 1e6))
def test_rounding_up_is_never_less_and_down_never_more(value):
    slack = 1e-9 * value  # for the last digits of binary numbers
    assert value - slack <= float(round_up(value)) <= value * 1.0011
    assert value * 0.9989 <= float(round_down(value)) <= value + slack


def test_a_file_gives_errors_and_missions_its_name(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text(TINY.replace('name = "tiny"\n', ""))
    assert read(file).name == "mine"
    file.write_text(TINY.replace("steps = 20", "steps = 20.5"))
    with pytest.raises(ScenarioError) as caught:
        read(file)
    assert str(caught.value) == f'{file}: leg.0.steps: must be an integer or "auto", got 20.5'


def test_tolerance_grows_with_the_disturbance():
    shaken = drawn("disturbance.acceleration_m_s2=1e-4")
    assert (shaken.replan_steps, shaken.auction_steps) == (1, 4)
    assert drawn("disturbance.acceleration_m_s2=1e-4", "replan_steps=2").replan_steps == 2
    calm, worse = (drawn(f"disturbance.acceleration_m_s2={a}") for a in (0, 1e-3))
    assert shaken.position_tolerance > 100 * calm.position_tolerance
    more, most = (m.position_tolerance - calm.position_tolerance for m in (shaken, worse))
    assert most / more == pytest.approx(10)


@pytest.mark.parametrize(("written", "step"), [(".5", 0.5), ("5.e-1", 0.5), ("+.5", 0.5)])
def test_numbers_without_a_digit_before_or_after_the_point_are_read(written, step):
    assert read("conflict", [f"plan.step_s={written}"]).step == step
