"""Run files: written whole or not at all, and read back as they were."""

import gc
import json
from dataclasses import replace

import numpy as np
import pytest
from full_disk import file_size_limit
from recorded_run import record_run

import sato
from dynamics import ClohessyWiltshire, DoubleIntegrator
from dynamics.inertial import InertialPlant
from dynamics.orbit import Orbit
from dynamics.plant import LinearPlant
from sato.reconfiguration.leg import Leg
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.state import ReconfigurationFrame
from sato.reconfiguration.system import SYSTEM
from sato.record import RunFileError
from sato.run_data import RunData, json_default
from sato.runs import Run, load

FLOWN = Reconfiguration(
    model=DoubleIntegrator(2),
    start=np.array([[0.0, 0.0], [1.0, 0.0]]),
    legs=(
        Leg(np.array([[0.0, 1.0], [1.0, 1.0]]), steps=2),
        Leg(np.array([[0.0, 1.0], [1.0, 1.0], [2.0, 1.0]]), steps=1, count=3),
    ),
    name="tiny",
    step=1.0,
    comm_radius=4.0,
    collision_radius=0.5,
    max_control=5.0,
    max_speed=3.0,
    horizon_steps=1,
    allow_undetectable=True,
)


def frames(
    rng: np.random.Generator, axes: int = 2, measured: bool = False
) -> list[ReconfigurationFrame]:
    end = {"kind": "leg_end", "target": [1, 0], "component": [0, 0]}
    events: list[tuple[dict[str, object], ...]] = [
        ({"kind": "leg_start", "agents": np.array([0, 1]), "leg": 0},),
        (),
        (end | {"leg": 0, "agents": [0, 1], "believed": [2, 3]},),
        (end | {"leg": 1, "agents": [0], "believed": [3, 3]},),
    ]
    found = []
    for k in range(4):
        position, velocity, control, applied, *seen = rng.normal(size=(6, 2, axes))
        seen = seen if measured and k < 3 else [None, None]
        alive, component = np.array([True, k < 2]), np.array([0, 0 if k < 2 else -1])
        leg, target, count = int(k >= 2), np.array([1, 0 if k < 2 else -1]), np.array([2, 2])
        flown = float(k), position, velocity, alive, component, control, applied
        found.append(ReconfigurationFrame(*flown, leg, target, count, *seen, None, None, events[k]))
    return found


def run_of(
    collected: list[ReconfigurationFrame], flown: Reconfiguration | None = None, **about: object
) -> Run:
    flown = flown or FLOWN
    drawn = flown.draw(np.random.default_rng(7))
    return record_run(SYSTEM, collected, drawn, flown, **({"name": "tiny", "seed": 7} | about))


@pytest.fixture
def run(rng: np.random.Generator) -> Run:
    return run_of(frames(rng))


def test_loaded_run_equals_the_saved_one(rng, tmp_path):
    run = run_of(frames(rng, measured=True))
    run.save(tmp_path / "deep" / "down")
    again = load(tmp_path / "deep" / "down")
    assert again.data.identical(run.data)
    assert again.summary == run.summary
    names = sorted(p.name for p in (tmp_path / "deep" / "down").iterdir())
    assert names == ["run.nc", "summary.json"]


def test_changes_of_the_dataset_do_not_change_the_run(run):
    before = run.recorded.compute_digest()
    run.data["position"].values[:] += 1.0
    run.data.attrs["seed"] = 8
    assert run.recorded.compute_digest() == before == run.recorded.attrs["digest"]


def test_variables_of_different_sizes_along_a_dimension_are_refused(run):
    longer = run.recorded.variables["time"]._replace(values=np.arange(5.0))
    with pytest.raises(ValueError, match="along time"):
        RunData({**run.recorded.variables, "time": longer}, {})


def test_every_variable_has_a_unit_and_a_long_name(rng, tmp_path):
    run_of(frames(rng, measured=True)).save(tmp_path)
    data = load(tmp_path / "run.nc").data
    for name, variable in data.variables.items():
        assert variable.attrs["units"], name
        assert variable.attrs["long_name"], name
    assert data["position"].dims == ("time", "agent", "axis")
    assert data["target_index"].dims == ("time", "agent")
    assert data["target_position"].dims == ("leg", "target", "axis")
    assert data["targets_believed"].dims == ("leg", "agent")


def test_attributes_hold_scenario_seed_and_limits(run, tmp_path):
    run.save(tmp_path)
    said = load(tmp_path).data.attrs
    assert sato.parse(said["scenario"]) == FLOWN
    assert (said["system"], said["name"], said["seed"]) == ("reconfiguration", "tiny", 7)
    assert (said["comm_radius_m"], said["collision_radius_m"]) == (4.0, 0.5)
    assert (said["max_control_m_s2"], said["max_speed_m_s"]) == (5.0, 3.0)


def test_last_controls_and_missing_targets_are_nan(run):
    controls = np.isfinite([run.data[name] for name in ("control", "applied_control")])
    assert controls[:, :-1].all() and not controls[:, -1].any()
    targets = np.isfinite(run.data["target_position"])
    assert not targets[0, 2].any() and targets[1, 2].all()
    np.testing.assert_array_equal(run.data["targets_believed"], [[2, 3], [3, -1]])


ORBIT = Orbit.from_elements(7000e3, 0.01, 0.9, raan=0.3, arg_perigee=0.2, k_J2=2.633e25)
PLANTS = {
    "inertial": InertialPlant(ORBIT),
    "model": LinearPlant(ClohessyWiltshire.from_orbit(ORBIT), ORBIT),
    "nowhere": LinearPlant(ClohessyWiltshire.from_orbit(ORBIT)),
}


def run_in_orbit(rng: np.random.Generator, plant: str) -> Run:
    states = np.zeros((3, 6))
    states[:, 0] = [0.0, 1.0, 2.0]
    orbit = replace(
        FLOWN,
        model=ClohessyWiltshire.from_orbit(ORBIT),
        plant=PLANTS[plant],
        start=states[:2],
        legs=(Leg(states[:2], steps=2), Leg(states, steps=1)),
        margin=0.0,
    )
    return run_of(frames(rng, axes=3), orbit)


@pytest.mark.parametrize("plant", ["inertial", "model"])
def test_orbit_of_the_plants_chief_is_recorded(rng, tmp_path, plant):
    run_in_orbit(rng, plant).save(tmp_path)
    data = load(tmp_path).data
    chief = data["chief"]
    assert chief.dims == ("time", "element")
    names = ["r", "v_x", "h", "node", "inclination", "latitude"]
    assert chief["element"].values.tolist() == names
    np.testing.assert_allclose(chief, ORBIT.elements_at(np.arange(4.0)), rtol=1e-12, atol=1e-12)
    assert chief.attrs["units"].split(", ") == ["m", "m/s", "m2/s", "rad", "rad", "rad"]
    assert chief["element"].attrs["long_name"]
    assert (data.attrs["mu_m3_s2"], data.attrs["k_j2_m5_s2"]) == (ORBIT.mu, 2.633e25)


def test_no_chief_is_recorded_without_an_orbit(run, rng):
    for data in (run_in_orbit(rng, "nowhere").data, run.data):
        assert "chief" not in data and "element" not in data
        assert "mu_m3_s2" not in data.attrs


def test_events_carry_their_time(run):
    [start] = run.events("leg_start")
    assert start == {"time": 0.0, "kind": "leg_start", "agents": [0, 1], "leg": 0}
    assert [event["time"] for event in run.events("leg_end")] == [2.0, 3.0]


def test_a_run_without_events_is_readable(rng, tmp_path):
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


def test_failed_save_leaves_the_old_run(run, rng, tmp_path):
    run.save(tmp_path)
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    broken = run_of(frames(rng))
    broken.summary["oops"] = object()
    with pytest.raises(TypeError):
        broken.save(tmp_path)
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == before


def test_only_runs_replace_the_files_of_a_run(run, tmp_path):
    run.save(tmp_path)
    with pytest.raises(sato.InputError, match=r"run.nc is a part of a run; another name would do"):
        run.export(tmp_path / "run.nc", "csv")
    with pytest.raises(sato.InputError, match=r"summary.json is a part of a run"):
        run.player(tmp_path / "summary.json")
    assert sato.load(tmp_path).verdict
    with pytest.raises(NotADirectoryError, match="is a file, and the name of a folder would do"):
        run.save(tmp_path / "run.nc")


@pytest.mark.parametrize("room", [0, 100, 10_000])
def test_full_disk_leaves_the_old_run_and_names_the_file(run, rng, tmp_path, room):
    (tmp_path / "old").mkdir()
    run.save(tmp_path / "old")
    before = {p.name: p.read_bytes() for p in (tmp_path / "old").iterdir()}
    for folder in ("old", "new"):
        with file_size_limit(room), pytest.raises(OSError, match="File too large") as caught:
            run_of(frames(rng)).save(tmp_path / folder)
        assert caught.value.filename == str(tmp_path / folder / "run.nc")
    assert {p.name: p.read_bytes() for p in (tmp_path / "old").iterdir()} == before
    assert list((tmp_path / "new").iterdir()) == []


def test_a_run_is_never_beside_the_summary_of_another(run, rng, tmp_path):
    run.save(tmp_path)
    with file_size_limit(10**6):
        other = run_of(frames(rng), stopped="interrupted")
        other.summary["remark"] = 2 * 10**6 * "!"
        with pytest.raises(OSError, match=r"summary\.json"):
            other.save(tmp_path)
    assert load(tmp_path).summary["stopped"] == "interrupted"


@pytest.mark.parametrize("part", [b"\x89HDF", b"OHDR", b"FRHP", b"BTHD", b"GCOL"])
def test_damaged_file_is_refused_in_one_sentence(run, tmp_path, part):
    run.save(tmp_path)
    file = tmp_path / "run.nc"
    file.write_bytes(file.read_bytes().replace(part, b"????"))
    with pytest.raises(RunFileError, match=r"run\.nc: cannot be read as netCDF-4"):
        load(tmp_path)
    gc.collect()  # a file that is half open would warn here


@pytest.mark.parametrize("share", [0.02, 0.3, 0.6, 0.99])
def test_truncated_file_is_refused_by_name(run, tmp_path, share):
    run.save(tmp_path)
    file = tmp_path / "run.nc"
    whole = file.read_bytes()
    file.write_bytes(whole[: int(len(whole) * share)])
    with pytest.raises(RunFileError, match=r"run\.nc"):
        load(tmp_path)


def test_other_files_are_refused_by_name(tmp_path):
    import xarray

    (tmp_path / "text.nc").write_text("not a run")
    with pytest.raises(RunFileError, match=r"text\.nc: cannot be read as netCDF-4"):
        load(tmp_path / "text.nc")
    xarray.Dataset({"rain": ("day", [1.0])}).to_netcdf(tmp_path / "rain.nc", engine="h5netcdf")
    with pytest.raises(RunFileError, match=r"rain\.nc: is not a run .* no time, "):
        load(tmp_path / "rain.nc")
    with pytest.raises(RunFileError, match="there is no such run file"):
        load(tmp_path)


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("scenario", "[swarm", "the scenario in the file cannot be read: .* is not TOML"),
        ("complete", [1.0, 2.0], "is damaged, for its complete is array"),
        ("peak_memory_mib", [1.0, 2.0], "is damaged, for its peak_memory_mib is array"),
    ],
)
def test_damaged_attributes_are_refused_in_one_sentence(run, tmp_path, name, value, reason):
    given = np.array(value) if isinstance(value, list) else value
    data = replace(run.recorded, attrs=run.recorded.attrs | {name: given}).seal()
    (tmp_path / "run.nc").write_bytes(data.to_netcdf())
    with pytest.raises(RunFileError, match=reason):
        load(tmp_path)


def test_damaged_summary_is_refused_and_missing_one_is_not(run, tmp_path):
    run.save(tmp_path)
    (tmp_path / "summary.json").write_text("{")
    with pytest.raises(RunFileError, match=r"summary\.json: is not readable JSON"):
        load(tmp_path)
    (tmp_path / "run.nc").rename(tmp_path / "copy.nc")
    assert load(tmp_path / "copy.nc").summary["seed"] == 7


def test_numbers_that_json_cannot_hold_are_null(run, tmp_path):
    run.summary["gap"] = [float("nan"), np.float64("inf")]
    assert load(run.save(tmp_path)).claimed["gap"] == [None, None]


def test_run_of_another_mission_is_refused(run, tmp_path):
    run.save(tmp_path)
    assert load(tmp_path, FLOWN).mission == FLOWN
    with pytest.raises(RunFileError, match="of another mission"):
        load(tmp_path, replace(FLOWN, max_speed=2.0))


def test_numpy_values_are_written_as_plain_json():
    values = [np.arange(2), np.float64(0.5), np.bool_(True)]
    assert json.loads(json.dumps(values, default=json_default)) == [[0, 1], 0.5, True]


def test_a_summary_of_another_run_breaks_its_promise(run, tmp_path):
    run.save(tmp_path)
    summary = tmp_path / "summary.json"
    summary.write_text(summary.read_text().replace(run.data.attrs["digest"], "0" * 64))
    loaded = sato.load(tmp_path)
    assert "summary" in [promise.name for promise in loaded.report.broken]
