"""Whether agents hear each other before they can meet [Morgan2016, Proposition 9]."""

from math import floor, inf

from sato.former.models import AnyModel
from sato.former.refusal import Refusal, downward, listed, upward
from sato.former.tables import Plan, Swarm


def detectable(swarm: Swarm, model: AnyModel, plan: Plan) -> bool:
    """Whether two agents that could meet within the horizon hear each other at its start.

        R_comm ≥ 2 V_max T_H Δt + R_col

    [Morgan2016, Proposition 9].
    """
    return swarm.comm_radius_m >= _least_radius(swarm, model, plan) * (1 - 1e-12)


def check_detectable(swarm: Swarm, model: AnyModel, plan: Plan) -> None:
    """Refuse agents that could meet unseen, unless that is what is to be shown.

    Raises:
        Refusal: They could; says which radius, speed or horizon would do.
    """
    if plan.allow_undetectable or detectable(swarm, model, plan):
        return
    needed, speed = _least_radius(swarm, model, plan), model.max_speed_m_s
    room = swarm.comm_radius_m - swarm.collision_radius_m
    cures = []
    if speed is not None:
        cures.append(f"swarm.comm_radius_m = {upward(needed)}")
    if room > 0:
        slower = room / (2 * plan.horizon_steps * plan.step_s)
        cures.append(f"model.max_speed_m_s = {downward(slower)}")
    if speed is not None and (shorter := floor(room / (2 * speed * plan.step_s) + 1e-9)) > 0:
        cures.append(f"plan.horizon_steps = {shorter}")
    if not cures:
        cures.append("a larger comm_radius_m with a model.max_speed_m_s")
    limit = f"{needed:.4g} m" if speed else "infinite, for there is no model.max_speed_m_s"
    raise Refusal(
        "swarm.comm_radius_m",
        f"{swarm.comm_radius_m:g} is less than 2 V_max T_H Δt + R_col, which is {limit}, so two "
        f"agents could meet within the horizon unseen (Proposition 9); {listed(cures)} would do, "
        "and plan.allow_undetectable = true flies it all the same",
    )


def _least_radius(swarm: Swarm, model: AnyModel, plan: Plan) -> float:
    speed = model.max_speed_m_s or inf
    return 2 * speed * plan.horizon_steps * plan.step_s + swarm.collision_radius_m
