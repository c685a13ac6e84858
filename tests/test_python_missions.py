"""Missions of the user's own, from Python alone: flown, checked, drawn, saved, loaded."""

import re
from dataclasses import replace
from pathlib import Path

import casadi
import numpy as np
import pytest

import sato

README = Path(__file__).parents[1] / "README.md"
RING = np.pi / 3 * np.arange(6)
PLANE = {
    "start": np.column_stack([1.5 * np.arange(6), np.zeros(6)]),
    "legs": [sato.Leg(4 * np.column_stack([np.cos(RING), np.sin(RING)]), steps=30)],
    "step": 1.0,
    "comm_radius": 20.0,
    "collision_radius": 0.5,
    "max_control": 0.3,
    "max_speed": 1.0,
}
SPACE = {
    "start": 100 * np.array([[1.0, 2.0, 0.0], [-1.0, 0.5, 0.0], [0.0, -2.0, 0.0]]),
    "legs": [sato.Leg(300 * np.array([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [0.5, 0.0, 0.0]]), 20)],
    "step": 60.0,
    "comm_radius": 5000.0,
    "collision_radius": 20.0,
    "max_control": 0.005,
    "max_speed": 2.0,
}


class Damped(sato.LinearModel):
    """Point mass with linear friction."""

    axes = 2

    def A(self, t: float) -> np.ndarray:
        """State matrix."""
        return np.block([[np.zeros((2, 2)), np.eye(2)], [np.zeros((2, 2)), -0.05 * np.eye(2)]])


def quadratic_drag(t, x, u):
    speed = casadi.sqrt(x[2] ** 2 + x[3] ** 2 + 1e-6)
    return casadi.vertcat(x[2:], u - 0.02 * speed * x[2:])


ORBIT = sato.Orbit.from_elements(6878e3, inclination=0.8)
MODELS = {
    "double integrator": (sato.DoubleIntegrator(2), PLANE),
    "Clohessy-Wiltshire": (sato.ClohessyWiltshire(1.1e-3), SPACE),
    "J2": (sato.J2(ORBIT), SPACE),
    "own linear model": (Damped(), PLANE),
    "own symbolic model": (sato.SymbolicModel(2, quadratic_drag), PLANE),
}


@pytest.mark.parametrize("name", MODELS)
def test_every_model_is_flown_checked_drawn_saved_and_loaded(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    model, rest = MODELS[name]
    mission = sato.Reconfiguration(model=model, **rest)
    run = sato.run(mission)
    assert run.summary["reached"] and run.check().kept
    assert all(path.is_file() for path in run.plot("mine"))
    run.save("mine")
    is_own = name.startswith("own")
    again = sato.load("mine", mission=mission if is_own else None)
    assert again.mission == mission
    assert again.check().kept
    if is_own:
        report = sato.load("mine").check()
        assert report.verdict == "unchecked" and not report.broken
        names = {promise.name for promise in report.promises}
        every = {promise.name for promise in again.check().promises}
        assert set(report.skipped) == every - names and "flight" in report.skipped


def test_a_mission_in_free_space_keeps_its_targets_without_an_orbit():
    drawn = sato.Reconfiguration(model=sato.ClohessyWiltshire(1.1e-3), **SPACE).draw(
        np.random.default_rng(0)
    )
    # Drift-free: ẏ = −2 n x [Clohessy1960].
    np.testing.assert_allclose(
        drawn.initial_states[:, 4], -2 * 1.1e-3 * drawn.initial_states[:, 0], atol=1e-12
    )


def test_replaced_missions_choose_again_what_they_were_not_given():
    space = sato.Reconfiguration(model=sato.ClohessyWiltshire(1.1e-3), horizon_steps=8, **SPACE)
    gusty = replace(space, disturbance=1e-5)
    periods = [drawn.draw(np.random.default_rng(0)).replan_steps for drawn in (space, gusty)]
    assert periods[0] > periods[1] == 1
    leg = SPACE["legs"][0]
    ordered = replace(leg, shape=sato.Points(leg.shape.positions, keep_order=True))
    assert leg.is_free and not ordered.is_free
    assert replace(ordered, shape=leg.shape) == leg


def test_an_orbit_shorter_than_any_is_doubted():
    drawn = sato.Reconfiguration(model=sato.ClohessyWiltshire(0.063), **(SPACE | {"step": 1.0}))
    with pytest.warns(UserWarning, match="an orbit takes 99.7 s, .* mean motion in rad/s"):
        sato.run(replace(drawn, max_control=5.0, max_speed=90.0))


@pytest.mark.parametrize("given", [{"port": 5000}, {"speed": 2.0}])
def test_settings_of_processes_are_refused_without_processes(given):
    (name,) = given
    with pytest.raises(sato.InputError, match=rf"{name}: is of processes; .*--free-running"):
        sato.run("crossing", **given)


def test_the_scripts_of_the_readme_run_in_an_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = README.read_text(encoding="utf-8")
    scripts = re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)
    assert len(scripts) >= 5
    exec(compile("\n".join(scripts), "README.md", "exec"), {"__name__": "readme"})
