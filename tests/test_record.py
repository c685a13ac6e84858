"""The run file: what goes in comes out, whole or not at all."""

import json
from dataclasses import replace

import numpy as np
import pytest

import sato.record
from dynamics import ClohessyWiltshire, DoubleIntegrator
from dynamics.inertial import InertialPlant
from dynamics.orbit import Orbit
from dynamics.plant import LinearPlant
from sato.reconfiguration.state import ReconfigurationFrame
from sato.reconfiguration.mission import Leg, Reconfiguration
from sato.reconfiguration.system import SYSTEM
from sato.record import Run, RunFileError, load


def mission() -> Reconfiguration:
    rest = np.zeros((3, 2))
    return Reconfiguration(
        linear_model=DoubleIntegrator(2),
        initial_states=np.hstack([[[0.0, 0.0], [1.0, 0.0]], rest[:2]]),
        alive=np.array([True, True]),
        legs=(
            Leg(np.hstack([[[0.0, 1.0], [1.0, 1.0]], rest[:2]]), steps=2),
            Leg(np.hstack([[[0.0, 2.0], [1.0, 2.0], [2.0, 2.0]], rest]), steps=1),
        ),
        step=1.0,
        comm_radius=3.0,
        collision_radius=0.5,
        max_control=0.1,
        max_speed=0.3,
    )


def frames(rng: np.random.Generator, measured: bool = False) -> list[ReconfigurationFrame]:
    def at(k: int, *events: dict[str, object]) -> ReconfigurationFrame:
        return ReconfigurationFrame(
            time=float(k),
            position=rng.normal(size=(2, 2)),
            velocity=rng.normal(size=(2, 2)),
            alive=np.array([True, k < 2]),
            component=np.array([0, 0 if k < 2 else -1]),
            control=rng.normal(size=(2, 2)),
            applied_control=rng.normal(size=(2, 2)),
            leg_index=int(k >= 2),
            target_index=np.array([1, 0 if k < 2 else -1]),
            target_count=np.array([2, 2]),
            measured_position=rng.normal(size=(2, 2)) if measured and k < 3 else None,
            measured_velocity=rng.normal(size=(2, 2)) if measured and k < 3 else None,
            events=events,
        )

    end = {"kind": "leg_end", "target": [1, 0], "component": [0, 0]}
    return [
        at(0, {"kind": "leg_start", "agents": np.array([0, 1]), "leg": 0}),
        at(1),
        at(2, end | {"leg": 0, "agents": [0, 1], "believed": [2, 3]}),
        at(3, end | {"leg": 1, "agents": [0], "believed": [3, 3]}),
    ]


def run_of(collected: list[ReconfigurationFrame], **said: object) -> Run:
    about = {"name": "tiny", "seed": 7, "version": "0", "wall_s": 0.5, "peak_memory_mib": 9.0}
    return Run.from_frames(
        SYSTEM, collected, mission(), "system = 'reconfiguration'\n", **(about | said)
    )


def test_what_was_saved_is_what_is_loaded(rng, tmp_path):
    run = run_of(frames(rng, measured=True))
    run.save(tmp_path / "deep" / "down")
    again = load(tmp_path / "deep" / "down")
    assert again.data.identical(run.data)
    assert again.summary == run.summary
    assert sorted(p.name for p in (tmp_path / "deep" / "down").iterdir()) == [
        "run.nc",
        "summary.json",
    ]


def test_every_variable_says_its_unit_and_its_meaning(rng, tmp_path):
    run_of(frames(rng, measured=True)).save(tmp_path)
    data = load(tmp_path / "run.nc").data
    for name, variable in data.variables.items():
        assert variable.attrs["units"], name
        assert variable.attrs["long_name"], name
    assert data["position"].dims == ("time", "agent", "axis")
    assert data["target_index"].dims == ("time", "agent")
    assert data["target_position"].dims == ("leg", "target", "axis")
    assert data["targets_believed"].dims == ("leg", "agent")


def test_the_attributes_tell_how_to_repeat_the_run(rng, tmp_path):
    run_of(frames(rng)).save(tmp_path)
    said = load(tmp_path).data.attrs
    assert said["scenario"] == "system = 'reconfiguration'\n"
    assert (said["system"], said["name"], said["seed"]) == ("reconfiguration", "tiny", 7)
    assert (said["comm_radius_m"], said["collision_radius_m"]) == (3.0, 0.5)
    assert (said["max_control_m_s2"], said["max_speed_m_s"]) == (0.1, 0.3)


def test_nothing_is_commanded_from_the_last_instant_on(rng):
    data = run_of(frames(rng)).data
    assert np.isnan(data["control"][-1]).all()
    assert np.isnan(data["applied_control"][-1]).all()
    assert np.isfinite(data["control"][:-1]).all()


def test_short_legs_are_padded_and_beliefs_are_those_of_the_live_at_the_end(rng):
    data = run_of(frames(rng)).data
    assert np.isnan(data["target_position"][0, 2]).all()
    np.testing.assert_array_equal(data["target_position"][1, 2], [2.0, 2.0])
    np.testing.assert_array_equal(data["targets_believed"], [[2, 3], [3, -1]])


ORBIT = Orbit.from_elements(7000e3, 0.01, 0.9, raan=0.3, arg_perigee=0.2, k_J2=2.633e25)
PLANTS = {
    "inertial": InertialPlant(ORBIT),
    "model": LinearPlant(ClohessyWiltshire.from_orbit(ORBIT), ORBIT),
    "nowhere": LinearPlant(ClohessyWiltshire.from_orbit(ORBIT)),
}


def run_in_orbit(rng: np.random.Generator, plant: str) -> Run:
    orbit = replace(
        mission(),
        linear_model=ClohessyWiltshire.from_orbit(ORBIT),
        plant=PLANTS[plant],
        initial_states=np.zeros((2, 6)),
        legs=(Leg(np.zeros((2, 6)), steps=2), Leg(np.zeros((2, 6)), steps=1)),
    )
    about = {"name": "o", "seed": 0, "version": "0", "wall_s": 0.0, "peak_memory_mib": 0.0}
    in_space = [
        f._replace(**{n: rng.normal(size=(2, 3)) for n in ("position", "velocity", "control")})
        for f in frames(rng)
    ]
    in_space = [f._replace(applied_control=f.control) for f in in_space]
    return Run.from_frames(SYSTEM, in_space, orbit, "", **about)


@pytest.mark.parametrize("plant", ["inertial", "model"])
def test_in_orbit_the_chief_of_the_plant_is_on_file(rng, tmp_path, plant):
    run_in_orbit(rng, plant).save(tmp_path)
    data = load(tmp_path).data
    chief = data["chief"]
    assert chief.dims == ("time", "element")
    names = ["r", "v_x", "h", "node", "inclination", "latitude"]
    assert chief["element"].values.tolist() == names
    np.testing.assert_allclose(chief, ORBIT.elements_at(np.arange(4.0)), rtol=1e-12, atol=1e-12)
    units = chief.attrs["units"].split(", ")
    assert (
        units == ["m", "m/s", "m2/s", "rad", "rad", "rad"] and chief["element"].attrs["long_name"]
    )
    assert (data.attrs["mu_m3_s2"], data.attrs["k_j2_m5_s2"]) == (ORBIT.mu, 2.633e25)


def test_where_there_is_no_orbit_there_is_no_chief_on_file(rng):
    for data in (run_in_orbit(rng, "nowhere").data, run_of(frames(rng)).data):
        assert "chief" not in data and "element" not in data
        assert "mu_m3_s2" not in data.attrs


def test_events_carry_their_time(rng):
    run = run_of(frames(rng))
    assert [(e["time"], e["kind"]) for e in run.events()] == [
        (0.0, "leg_start"),
        (2.0, "leg_end"),
        (3.0, "leg_end"),
    ]
    assert run.events("leg_start") == [
        {"time": 0.0, "kind": "leg_start", "agents": [0, 1], "leg": 0}
    ]


def test_a_run_in_which_nothing_happened_is_a_run(rng, tmp_path):
    quiet = [f._replace(events=()) for f in frames(rng)]
    run_of(quiet).save(tmp_path)
    assert load(tmp_path).events() == []


def test_an_interrupted_run_is_readable(rng, tmp_path):
    run_of(frames(rng)[:2], stopped="interrupted").save(tmp_path)
    data = load(tmp_path).data
    assert (data.sizes["time"], data.attrs["complete"]) == (2, 0)
    np.testing.assert_array_equal(data["targets_believed"], [[-1, -1], [-1, -1]])


def test_a_run_needs_a_frame():
    with pytest.raises(ValueError, match="at least one frame"):
        run_of([])


def test_a_failed_save_leaves_the_old_run_and_nothing_half_written(rng, tmp_path):
    run_of(frames(rng)).save(tmp_path)
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    broken = run_of(frames(rng))
    broken.summary["oops"] = object()
    with pytest.raises(TypeError):
        broken.save(tmp_path)
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == before


def test_a_crash_while_the_file_is_written_leaves_nothing(rng, tmp_path, monkeypatch):
    run = run_of(frames(rng))

    def fall(_: object, path: object, **__: object) -> None:
        with open(path, "wb") as file:  # type: ignore[call-overload]
            file.write(b"half")
        raise OSError("disk full")

    monkeypatch.setattr(type(run.data), "to_netcdf", fall)
    with pytest.raises(OSError, match="disk full"):
        run.save(tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("share", [0.02, 0.3, 0.6, 0.99])
def test_a_file_cut_short_is_refused_by_name(rng, tmp_path, share):
    run_of(frames(rng)).save(tmp_path)
    file = tmp_path / "run.nc"
    whole = file.read_bytes()
    file.write_bytes(whole[: int(len(whole) * share)])
    with pytest.raises(RunFileError, match=r"run\.nc"):
        load(tmp_path)


def test_what_is_not_a_run_is_refused_by_name(tmp_path):
    import xarray

    (tmp_path / "text.nc").write_text("not a run")
    with pytest.raises(RunFileError, match=r"text\.nc: cannot be read as netCDF-4"):
        load(tmp_path / "text.nc")
    xarray.Dataset({"rain": ("day", [1.0])}).to_netcdf(tmp_path / "rain.nc", engine="h5netcdf")
    with pytest.raises(RunFileError, match=r"rain\.nc: is not a run .* no time, "):
        load(tmp_path / "rain.nc")
    with pytest.raises(RunFileError, match="there is no such run file"):
        load(tmp_path)


def test_a_damaged_summary_is_refused_and_a_missing_one_is_not_needed(rng, tmp_path):
    run_of(frames(rng)).save(tmp_path)
    (tmp_path / "summary.json").write_text("{")
    with pytest.raises(RunFileError, match=r"summary\.json: is not readable JSON"):
        load(tmp_path)
    (tmp_path / "summary.json").unlink()
    assert load(tmp_path).summary["seed"] == 7


def test_numpy_is_written_as_plain_json():
    said = {"a": np.arange(2), "b": np.float64(0.5), "c": np.bool_(True)}
    assert json.loads(json.dumps(said, default=sato.record.json_default)) == {
        "a": [0, 1],
        "b": 0.5,
        "c": True,
    }
