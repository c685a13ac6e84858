"""Vehicles with limits of their own, and limits of each axis, in whole missions."""

from dataclasses import replace

import numpy as np
import pytest

import sato
from problems.limit import Limit
from sato.scenario.errors import InputError
from sato.scenario.file import read

ANGLE = np.arange(4) * np.pi / 2
START = 3.0 * np.c_[np.cos(ANGLE), np.sin(ANGLE)]
LIMITS = {"max_control": 0.1, "max_speed": 0.5}
BOX = {"max_control_axes": (0.06, 0.12), "max_speed_axes": (0.3, 0.5), "speed_norm": "inf"}
OWN = {"max_control": (0.05, 0.15, 0.1, 0.12), "max_speed": (0.3, 0.4, 0.6, 0.5)}


def mission(rng=None, **changes):
    """Four that cross a ring to given targets, not quite opposite."""
    aside = np.zeros_like(START) if rng is None else rng.normal(0, 0.3, START.shape)
    values = {
        "model": sato.DoubleIntegrator(2),
        "start": START,
        "legs": [sato.Leg(aside - START, steps=32)],
        "step": 1.0,
        "comm_radius": 30.0,
        "collision_radius": 0.5,
        "foresight_steps": 32,
        "assignment": "given",
    }
    return sato.Reconfiguration(**(values | changes))


@pytest.mark.parametrize("limits", [BOX, OWN], ids=["box", "own"])
def test_flights_keep_limits_of_each_axis_and_vehicle(rng, limits, tmp_path):
    run = sato.run(mission(rng, **limits))
    flown, report = run.mission, run.check()
    assert report.kept, str(report)
    u, v = np.abs(run.data["control"].values[:-1]), run.data["velocity"].values
    if "max_control" in limits:
        assert (u <= np.array(limits["max_control"])[:, None] * (1 + 1e-9)).all()
        assert (np.linalg.norm(v, axis=2) <= np.array(limits["max_speed"]) * (1 + 1e-6)).all()
        assert (u.max(axis=(0, 2)) > 0.5 * np.array(limits["max_control"])).any()
    else:
        assert (u <= np.array(BOX["max_control_axes"]) * (1 + 1e-9)).all()
        assert (np.abs(v) <= np.array(BOX["max_speed_axes"]) * (1 + 1e-6)).all()
    run.save(tmp_path)
    assert sato.load(tmp_path).check().kept
    assert sato.load(tmp_path).mission == flown
    faster = run.data.copy()
    k, i = np.unravel_index(np.argmax(u.max(axis=2)), u.shape[:2])
    faster["control"][k, i] *= 1.01 * flown.control_limit(int(i)).most / u[k, i].max()
    assert not sato.Run(faster, run.summary, flown).check().kept


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({}, "model.max_control_m_s2: is missing"),
        (LIMITS | {"max_control_axes": (0.1, 0.1)}, "is given beside max_control_m_s2"),
        (BOX | {"max_speed": 0.4}, "is given beside max_speed_m_s"),
        (BOX | {"max_control_axes": (0.1, 0.1, 0.1)}, "has 3 entries, and the model has 2 axes"),
        (BOX | {"max_control_axes": (0.1, 0.0)}, "must be greater than 0, got 0"),
        (BOX | {"control_norm": 2}, r"control_norm = 2; control_norm = \"inf\" would do"),
        (BOX | {"speed_norm": 2}, r"speed_norm = 2; speed_norm = \"inf\" would do"),
        (OWN | {"max_control": (0.1, 0.2)}, "has 2 entries for 4 vehicles"),
        (OWN | {"max_speed": (0.1, 0.2, -0.1, 0.3)}, r"max_speed_m_s\.2: .*greater than 0, got -0"),
    ],
)
def test_limits_that_do_not_fit_are_refused_with_those_that_would(changes, message):
    with pytest.raises(InputError, match=message):
        mission(**changes)


def test_limits_survive_a_file_in_other_units(tmp_path):
    path = tmp_path / "mission.toml"
    written = mission(**OWN).to_toml()
    path.write_text(written)
    assert read(path).max_control == OWN["max_control"]
    path.write_text(written.replace("max_control_m_s2 = [", "max_control_mm_s2 = ["))
    assert read(path).max_control == pytest.approx(1e-3 * np.array(OWN["max_control"]))


def test_equal_lists_fly_as_numbers_do(rng):
    lists = {name: (value,) * 4 for name, value in LIMITS.items()}
    aside = mission(rng, **LIMITS)
    one, other = sato.run(aside), sato.run(replace(aside, **lists))
    np.testing.assert_array_equal(one.data["position"], other.data["position"])


def test_slow_vehicles_are_told_what_would_do():
    with pytest.raises(InputError, match=r"agent 0 can reach none .* times the limits"):
        sato.run(mission(**OWN | {"max_control": (0.01, 0.1, 0.1, 0.1)}))


def test_the_largest_speed_in_a_norm_is_that_of_its_set():
    assert Limit(0.5, 2, 3).largest_length == Limit(0.5, 1, 3).largest_length == 0.5
    assert Limit(0.5, "inf", 2).largest_length == pytest.approx(0.5 * 2**0.5)
    assert mission(**BOX).top_speeds == pytest.approx([(0.3**2 + 0.5**2) ** 0.5])
