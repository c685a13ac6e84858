"""Reconfigurations over a network that loses and delays messages, with vehicles that are lost.

50 vehicles start at random positions in a square of 12 m, at least 1.2 m apart, and form three of
the letters S, A, T, O, U, I and C, targets 1.4 m apart, in 60 steps of 1 s each. Of each 10, 3 are
lost: each at a step drawn from those of the first two legs. Positions are measured with 2 % of
R_col = 0.5 m, thrusts err by 5 %. A decision has the 4 s until the next, in rounds of 1 ms. With
R_comm = 17.5 m the reach rule lets vehicles fly at their full speed of 0.4 m/s under all faults of
the campaign.
"""

import json
from typing import Any

import numpy as np
from judge import judge

AGENTS, LOST_SHARE, STEPS = 50, 0.3, 60
LETTERS = "SATOUIC"
FILE = {
    "system": "reconfiguration",
    "swarm": {
        "agents": AGENTS,
        "start": {"kind": "random", "box_m": 12.0, "separation_m": 1.2},
        "comm_radius_m": 17.5,
        "collision_radius_m": 0.5,
    },
    "model": {
        "kind": "double_integrator",
        "dimension": 2,
        "max_control_m_s2": 0.1,
        "max_speed_m_s": 0.4,
    },
    "plan": {"step_s": 1.0, "horizon_steps": 8, "replan_steps": 4},
    "link": {"round_s": 0.001},
    "disturbance": {"position_m": 0.01, "thrust": 0.05},
}


def lose_some(rng: np.random.Generator, lost_share: float = LOST_SHARE) -> dict[str, Any]:
    """Draw letters, and which vehicles are lost when."""
    letters = rng.choice(list(LETTERS), 3, replace=False)
    lost = rng.choice(AGENTS, round(lost_share * AGENTS), replace=False).tolist()
    at = rng.integers(0, 2 * STEPS, len(lost)).tolist()
    legs = []
    for number, letter in enumerate(letters.tolist()):
        shape = {"kind": "text", "text": letter, "spacing_m": 1.4}
        own = [
            (i, k - number * STEPS) for i, k in zip(lost, at, strict=True) if k // STEPS == number
        ]
        lose = [{"kind": "agents", "agents": [i], "at_step": k} for i, k in own]
        legs.append({"shape": shape, "steps": STEPS, "targets": AGENTS, "lose": lose})
    legs[-1]["recount"] = True
    return {**FILE, "leg": legs}


def judge_run(run: Any) -> dict[str, Any]:
    """Judge a run, and count its steps, its decisions and what did not get through."""
    legs = run.summary["legs"]
    events = [json.loads(str(text)) for text in run.data["event"].values]
    unconfirmed = [event for event in events if event["kind"] == "unconfirmed"]
    return {
        "judged": judge(run.data),
        "steps": sum(leg["steps"] for leg in legs),
        "is_closed": legs[-1]["reached"] and legs[-1]["holes"] == 0,
        "undecided": len(unconfirmed),
        "unconfirmed": sum(len(event["agents"]) for event in unconfirmed),
    }
