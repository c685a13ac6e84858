"""Links that a mission cannot have, or over which nothing can be agreed, and what would do."""

import re

import numpy as np
import pytest
from graphs import complete, line
from reconfiguration_runs import fly, make_mission, row

import sato
from sato.network.flooding import census_rounds
from sato.network.link import Link
from sato.reconfiguration import link_feasibility, network_decision
from sato.reconfiguration.link_feasibility import count_rounds, measure_round
from sato.scenario.file import read

POOR = {"link.loss": 0.2, "link.late": 3, "link.outage_s": 0.025, "link.outage_share": 0.5}


def draw(name="crossing", **keys):
    overrides = [f"{key}={value}" for key, value in keys.items()]
    return read(name, overrides).draw(np.random.default_rng(0))


REFUSED = [
    ({"link.loss": 1}, r"link\.loss: must be less than 1, got 1"),
    ({"link.every": 2}, r"link\.every: agents send a message in every round.* leave it out"),
    (
        {"link.outage_s": 2, "link.outage_share": 0.3},
        r"link\.round_s: is 0, and outages of 2 s are counted in rounds",
    ),
    ({"link.skew_s": 9}, r"link\.skew_s: 9 is more than the replanning period of 2 s"),
    (
        {"link.round_s": 0.02, "link.late": 5000},
        r"link\.late: messages may come 100 s late, and leg 0 takes 36 s; link\.late = 1",
    ),
    ({"plan.printed": "true"}, r"plan\.printed: over a \[link\] .*; printed = false would do"),
    ({"plan.orders": 2}, r"plan\.orders: over a \[link\] .*; orders = 1 would do"),
    ({"plan.orders": 2, "plan.bargains": 1}, r"plan\.orders: over a \[link\]"),
    ({"plan.assignment": "central"}, r'plan\.assignment: over a \[link\].*"auction" would do'),
    (
        {"link.skew_s": 1, "obstacle": "[{kind='sphere', center_m=[9, 9], radius_m=1,"
         " velocity_m_s=[0.1, 0]}]"},
        r"obstacle: what moves .*; link\.skew_s = 0 would do",
    ),
    ({"link.skew_s": 1, "leg.lose": "{kind='agents', agents=[0], body='coast'}"}, r"leg\.lose\.bo"),
]  # fmt: skip


@pytest.mark.parametrize(("keys", "message"), REFUSED)
def test_links_and_missions_that_do_not_go_together_are_refused(keys, message):
    with pytest.raises(ValueError, match=message):
        draw(**({"link.round_s": 0.01} if not any("link" in key for key in keys) else {}) | keys)


@pytest.mark.parametrize("name", ["orbit", "random_cw"])
def test_spacecraft_over_links_that_take_time_are_refused(name):
    with pytest.raises(ValueError, match=r'model\.kind: .*; "double_integrator" would do'):
        draw(name, **{"link.round_s": 0.01})


def test_starts_in_motion_are_refused_where_clocks_differ():
    start, leg = np.array([[0.0, 0.0, 0.1, 0.0], [0.0, 3.0, 0.0, 0.0]]), sato.Leg(row(2, 4.0), 40)
    with pytest.raises(
        sato.InputError, match=r"swarm\.start: agent 0 starts in motion, .* rest, o"
    ):
        make_mission(start, leg, link=Link(skew=0.2), comm_radius=9.0, collision_radius=0.4)


@pytest.mark.parametrize(
    "keys",
    [
        {"link.round_s": 0.5},
        {"link.round_s": 0.05} | POOR,
        {"link.round_s": 0.02, "link.late": 200},
        {"name": "random", "link.round_s": 0.01, "link.skew_s": 0.9},
    ],
)
def test_what_is_suggested_for_too_few_rounds_would_do(keys):
    with pytest.raises(ValueError, match=r"link\.round_s: .* leave \d+ rounds") as refused:
        draw(**keys)
    found = re.findall(
        r"(link\.late|link\.round_s|plan\.replan_steps) = ([\d.e-]+)", str(refused.value)
    )
    cures = [
        (key, value) for key, value in found if f"{key} = {value} of" not in str(refused.value)
    ]
    assert len(cures) >= 1
    for key, value in cures:
        draw(**keys | {key: value})


def test_a_synchronous_round_takes_one_of_a_perfect_link_more_of_others():
    assert measure_round(Link(round=1.0), complete(5)) == 1.0
    lossy = Link(round=1.0, loss_probability=0.5)
    # Neither of two waits less than for its own message, which is heard after 2 rounds on average.
    pair, more = (measure_round(lossy, graph) for graph in (line(2), complete(8)))
    assert 1.9 < pair < more < 8
    late = measure_round(Link(round=1.0, late=4), line(2))
    assert 1.0 < late < 5.0


@pytest.mark.parametrize("given", [False, True])
def test_no_decision_of_two_takes_fewer_rounds_than_the_least(given, monkeypatch):
    taken, finish = [], network_decision.DecisionsUnderWay.finish

    def count(self, mission, stops):
        for outcome in self.outcomes:
            census = census_rounds(self.graph.diameter)
            taken.append(int((census + sum(load.rounds for load in outcome.loads)).max()) + 1)
        return finish(self, mission, stops)

    monkeypatch.setattr(network_decision.DecisionsUnderWay, "finish", count)
    targets = sato.Points([[3.0, 4.0], [0.0, 4.0]], keep_order=True)
    assignment = "given" if given else "auction"
    link = {"link": Link(round=0.001), "comm_radius": 20.0, "assignment": assignment}
    mission = make_mission(np.array([[0.0, 0.0], [3.0, 0.0]]), sato.Leg(targets, 40), **link)
    fly(mission)
    assert len(taken) >= 1 and min(taken) >= link_feasibility.least_rounds(mission)


@pytest.mark.parametrize("skew", [0.5, 1.0, 1.9])
def test_two_whose_clocks_differ_without_a_warning_agree(skew):
    start = np.array([[0.0, 0.0], [5.0, 0.0]])
    periods = {"replan_steps": 4, "horizon_steps": 8, "auction_steps": 8}
    link = Link(round=0.001, skew=skew)
    own = start, sato.Leg(start + np.array([0.0, 3.0]), 40)
    mission = make_mission(*own, comm_radius=400.0, link=link, **periods)
    assert mission.warnings() == []
    for seed in range(8):
        frames = fly(mission, seed)
        assert not any(e["kind"] == "unconfirmed" for f in frames for e in f.events)
    apart = Link(round=0.001, skew=2.5)
    (warning,) = make_mission(*own, comm_radius=400.0, link=apart, **periods).warnings()
    assert "has 0 rounds" in warning and "link.skew_s = 1.9" in warning


def test_networks_that_grow_on_the_way_are_warned_of():
    far = 8.0 * np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [0.0, 1.0], [1.0, 1.0], [2.0, 1.0]])
    leg = sato.Leg(0.2 * far + [6.0, 3.0], 80)
    options = {"comm_radius": 5.0, "max_speed": 0.1, "allow_undetectable": True}
    mission = make_mission(far, leg, link=Link(round=0.07), **options)
    (warning,) = [text for text in mission.warnings() if "rounds of messages" in text]
    assert "the 6 agents that meet in leg 0 in one network" in warning


def test_warnings_say_where_a_link_slows_down_or_leaves_little_time():
    (none,) = draw(**{"link.loss": 0.2}).warnings()
    assert none.startswith("messages that are lost or late change nothing")
    mission = draw("random", **{"link.round_s": 0.01, "link.loss": 0.2})
    slow, few = mission.warnings()
    assert f"{mission.slow_speed:.3g} m/s" in slow and "comm_radius_m = " in slow
    has = count_rounds(mission, mission.link, mission.replan_steps)
    assert few.startswith(f"a decision has {has} rounds") and "link.round_s = " in few
    assert draw(**{"link.round_s": 0.001}).warnings() == draw().warnings() == []
