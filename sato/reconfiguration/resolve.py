"""Margins, tolerances, limits and increments of a drawn mission, as numbers."""

from dataclasses import replace
from math import isfinite

import numpy as np

from problems.auction_cost import compute_energies
from problems.convexify import SEPARATION_TOLERANCE
from sato.reconfiguration import tolerances
from sato.reconfiguration.mission import Reconfiguration
from sato.scenario.definition import is_auto
from sato.scenario.errors import InputError, join_names, round_down, round_up

ARRIVAL_TOLERANCE = 1e-6  # of the least spacing of the targets
CONTROL_FACTOR = 10.0  # times a control that is enough for any way of the mission


def resolve(mission: Reconfiguration) -> Reconfiguration:
    """Return a drawn mission with its margin, tolerances, limits and bid increment as numbers."""
    mission = _cut_control(mission)
    # A single target has no spacing; the least distance that there may be stands for it.
    spacing = mission.target_spacing
    least = ARRIVAL_TOLERANCE * (spacing if isfinite(spacing) else mission.largest_separation)
    given, margin = mission.position_tolerance, mission.known_margin
    is_computed = not mission.has_margin
    noise = wrong = (0.0, 0.0)
    if mission.has_noise or not mission.flies_model or mission.link.skew:
        noise = tolerances.noise_on_arrival(mission)
        wrong = wrong if given else tolerances.model_error_on_arrival(mission)
        margin = tolerances.compute_margin(mission) if is_computed else margin
    check_skew(mission, margin)
    pairs = [mission.find_tightest(leg.targets) for leg in mission.legs]
    tightest = min(pairs, key=lambda pair: pair[0] - pair[1])  # the one with the least room
    verb = "auto gives" if is_computed else "takes"
    check_margin(margin, verb, *tightest, mission.skew_margin(margin))
    increment = mission.epsilon
    if is_auto(increment) and not isfinite(spacing):
        increment = mission.tie_break * mission.largest_separation**2 / 2 or increment
    velocity = mission.velocity_tolerance
    return replace(
        mission,
        position_tolerance=given or least + noise[0] + wrong[0],
        velocity_tolerance=velocity or (given or least) / mission.step + noise[1] + wrong[1],
        epsilon=increment,
        margin=margin,
    )


def check_margin(margin: float, verb: str, spacing: float, R: float, least: float = 0.0) -> None:
    """Refuse a margin that leaves no room between two targets.

    They are as far apart as the spacing, and their vehicles keep R without a margin [m]. The
    verb says how the margin comes about, for the error, and `least` what would do at least [m].
    """
    kept = 1 + SEPARATION_TOLERANCE
    if margin > 0 and (R + margin) * kept > spacing * (1 + 1e-9):
        enough, room = round_up((R + margin) * kept), spacing / kept - R
        cures = [f"a shape with {enough} m", "less skew" if least else "less noise"]
        if room >= least:
            cures.append(f"margin_m = {round_down(room) if room > 0 else 0}")
        raise InputError(
            "plan.margin_m",
            f"{verb} {margin:.4g} m beyond the collision radius of {R:g} m, and targets are "
            f"{spacing:.8g} m apart; {join_names(cures)} would do",
        )


def check_skew(mission: Reconfiguration, margin: float) -> None:
    """Refuse a margin by which vehicles do not keep apart as their clocks differ."""
    least = mission.skew_margin(margin)
    if margin < least * (1 - 1e-9):
        reason = f"{margin:g} is less than the {least:.4g} m that two come nearer than planned"
        skew = f"as their clocks differ by link.skew_s = {mission.link.skew:g}"
        cures = f'"auto", or {round_up(least)} would do'
        raise InputError("plan.margin_m", f"{reason}, {skew}; {cures}")


def _cut_control(mission: Reconfiguration) -> Reconfiguration:
    """Return the mission with limits of the control not far above all that could be of use.

    Programs in which a limit is millions of times what is needed are badly scaled, and their
    answers are inexact.
    """
    largest = mission.largest_control.max()
    if largest <= _control_to_cross(mission):
        return mission
    most = max(_control_to_cross(mission), _control_of_legs(mission))
    if largest <= most:
        return mission
    each, axes = mission.max_control, mission.max_control_axes
    if axes is not None:
        return replace(mission, max_control_axes=tuple(min(u, most) for u in axes))
    if isinstance(each, tuple):
        return replace(mission, max_control=tuple(min(u, most) for u in each))
    return replace(mission, max_control=most)


def _control_to_cross(mission: Reconfiguration) -> float:
    """Compute what takes a vehicle across the whole mission within a step, times a factor."""
    states = np.concatenate([mission.initial_states, *(leg.targets for leg in mission.legs)])
    away = float(np.ptp(states[:, : mission.axes], axis=0).max()) + mission.largest_separation
    fastest = float(np.abs(states[:, mission.axes :]).max())
    return CONTROL_FACTOR * (away / mission.step**2 + fastest / mission.step)


def _control_of_legs(mission: Reconfiguration) -> float:
    """Bound all controls of the least energy or fuel in any transfer of a leg, times a factor.

    No control of least fuel is above the fuel of the control of least energy, and that is at most
    √(T d) times its Euclidean length. A displacement from start i to target j is the sum of those
    of (i, 0) and (0, j) less that of (0, 0), so that three times the largest of these is enough.
    """
    most, begin, start = 0.0, 0.0, mission.initial_states
    for leg in mission.legs:
        model = mission.discretize(leg.steps, begin)
        pairs = (start, leg.targets[:1]), (start[:1], leg.targets)
        energy = max(float(compute_energies(model, *pair).max()) for pair in pairs)
        most = max(most, (leg.steps * mission.axes * energy / mission.step) ** 0.5)
        start = np.concatenate([mission.initial_states, leg.targets])
        begin += leg.steps * mission.step
    return CONTROL_FACTOR * most
