"""Trajectories for other tools: what they read is what was flown."""

import csv
import warnings
from dataclasses import replace

import numpy as np
import pytest
from recorded_run import fly_straight, make_mission, recorded
from test_reconfiguration_figures import orbit

import sato.export
from dynamics.coordinate_frames import LVLH, inertial_state
from dynamics.orbit import K_J2
from sato.export import export, format_utc

with warnings.catch_warnings():  # of what it brings along, none is ours to heed
    warnings.simplefilter("ignore")
    from astropy.time import TimeDelta
    from oem import OrbitEphemerisMessage


@pytest.fixture(scope="module")
def about():
    return orbit()


@pytest.fixture(scope="module")
def run(about):
    """Two legs of twelve craft about a chief; one is lost between them."""
    data = recorded(about).recorded
    return replace(data, attrs={**data.attrs, "epoch": "2027-02-03T04:05:06.500000"})


@pytest.fixture(scope="module")
def folder(run, tmp_path_factory):
    return export(run, tmp_path_factory.mktemp("out") / "oem")


def states(path):
    """States of a message [m, m/s], as a library reads it."""
    found = OrbitEphemerisMessage.open(path)
    return 1000 * np.array([np.concatenate([s.position, s.velocity]) for s in found.states])


def test_every_object_has_a_message_of_its_own_that_a_library_reads(run, folder):
    names = [f"agent-{j:02}" for j in range(12)]
    assert {p.name for p in folder.iterdir()} == {f"{name}.oem" for name in (*names, "chief")}
    for path in folder.iterdir():
        found = OrbitEphemerisMessage.open(path)
        [segment] = found.segments
        said = segment.metadata
        assert (said["OBJECT_NAME"], said["CENTER_NAME"]) == (path.stem, "EARTH")
        assert (said["REF_FRAME"], said["TIME_SYSTEM"]) == ("EME2000", "UTC")
        steps = 20 if path.stem == "agent-03" else 32
        assert said["START_TIME"].isot == "2027-02-03T04:05:06.500000"
        since = (said["STOP_TIME"] - said["START_TIME"]).sec
        assert since == pytest.approx(60 * (steps - (path.stem == "agent-03")), abs=1e-6)


def test_back_in_the_frame_of_the_chief_all_is_as_it_was_flown(run, about, folder):
    chief = np.asarray(run["chief"], dtype=float)
    np.testing.assert_allclose(states(folder / "chief.oem"), inertial_state(chief), rtol=1e-15)
    frame = LVLH.from_polar_nodal(chief, K_J2)
    for j in (0, 7, 11):
        back = frame.from_inertial(states(folder / f"agent-{j:02}.oem"))
        np.testing.assert_allclose(back[:, :3], run["position"][:, j], rtol=0, atol=1e-8)
        np.testing.assert_allclose(back[:, 3:], run["velocity"][:, j], rtol=0, atol=1e-10)


def test_the_cubic_that_a_message_recommends_follows_the_orbit(about, folder):
    found = OrbitEphemerisMessage.open(folder / "chief.oem")
    start = found.segments[0].metadata["START_TIME"]
    half = start + TimeDelta(10.5 * 60, format="sec")
    there = inertial_state(about.flown_plant.chief_elements(10.5 * 60))
    # h⁴/384 · n⁴ r: what a cubic misses of a circle of 6,878 km, in steps of a minute.
    assert np.linalg.norm(1000 * found(half).position - there[:3]) < 0.35


def test_messages_obey_the_syntax_of_the_standard(folder):
    for path in folder.iterdir():
        text = path.read_bytes().decode("ascii")
        assert "\t" not in text and "\r" not in text
        for line in text.splitlines():
            assert len(line) <= 254
            if line[:1].isdigit():
                _, *numbers = line.split(" ")
                assert len(numbers) == 6
                for number in numbers:
                    mantissa, _ = number.lstrip("-").split("e")
                    assert mantissa[1] == "." and len(mantissa) - 1 <= 16


def test_times_are_said_to_the_nanosecond_only_where_they_need_it(run):
    assert format_utc(run, np.array([0.0, 90.0])) == [
        "2027-02-03T04:05:06.500", "2027-02-03T04:06:36.500",
    ]  # fmt: skip
    third = np.array([1 / 3])
    assert format_utc(run, third) == ["2027-02-03T04:05:06.833333333"]
    assert format_utc(recorded(make_mission()).recorded, np.zeros(1)) == ["2026-01-01T00:00:00.000"]


def test_an_agent_seen_once_is_written_without_an_interpolation(about, tmp_path):
    once = recorded(about, fly_straight(about)[:1]).recorded
    path = export(once, tmp_path / "oem") / "agent-05.oem"
    assert len(states(path)) == 1
    assert "INTERPOLATION" not in OrbitEphemerisMessage.open(path).segments[0].metadata


def rows(path):
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_the_table_holds_every_state_in_both_frames_to_the_last_bit(run, tmp_path):
    table = rows(export(run, tmp_path / "all.csv", "csv"))
    assert len(table) == 33 + 11 * 33 + 20
    frame = LVLH.from_polar_nodal(np.asarray(run["chief"], dtype=float), K_J2)
    lvlh = [f"lvlh_{n}" for n in ("x_m", "y_m", "z_m", "vx_m_s", "vy_m_s", "vz_m_s")]
    for row in table[:33:8]:
        k = round(float(row["time_s"]) / 60)
        assert row["object"] == "chief" and all(float(row[name]) == 0 for name in lvlh)
        assert float(row["inertial_x_m"]) == frame.chief_state[k, 0]
    row = table[33 * 3 + 13]
    assert (row["object"], row["time_s"], row["utc"]) == (
        "agent-02", "780.0", "2027-02-03T04:18:06.500",
    )  # fmt: skip
    x = [float(row[name]) for name in lvlh]
    assert x[:3] == list(run["position"][13, 2])
    there = [float(row[name.replace("lvlh", "inertial")]) for name in lvlh]
    x = np.concatenate([run["position"], run["velocity"]], axis=-1)
    np.testing.assert_array_equal(there, frame.to_inertial(x)[13, 2])


def test_a_run_without_a_chief_has_a_table_of_its_own_axes_alone(tmp_path):
    table = rows(export(recorded(make_mission()).recorded, tmp_path / "new" / "plane.csv", "csv"))
    assert list(table[0]) == ["object", "time_s", "x_m", "y_m", "vx_m_s", "vy_m_s"]
    assert {row["object"] for row in table} == {f"agent-{j}" for j in range(7)}


def test_what_was_exported_before_is_replaced_as_a_whole(run, about, tmp_path):
    export(run, tmp_path / "oem")
    (tmp_path / "oem" / "agent-99.oem").write_text("stale")
    export(run, tmp_path / "oem")
    assert len(list((tmp_path / "oem").iterdir())) == 13
    assert export(run, tmp_path / "t.csv", "csv") == export(run, tmp_path / "t.csv", "csv")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["oem", "t.csv"]


def test_what_is_no_export_is_not_replaced(run, tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").write_text("years of work")
    with pytest.raises(ValueError, match=r"thesis\.tex.* another folder would do"):
        export(run, tmp_path / "mine")
    with pytest.raises(ValueError, match="is a file, and OEMs"):
        export(run, tmp_path / "mine" / "thesis.tex")
    with pytest.raises(ValueError, match="is a folder, and a table"):
        export(run, tmp_path / "mine", "csv")
    with pytest.raises(ValueError, match='no format "stk", only oem, csv and rrd'):
        export(run, tmp_path / "x", "stk")
    with pytest.raises(ValueError, match=r"needs a \[chief\].* csv"):
        export(recorded(make_mission()).recorded, tmp_path / "oem")
    assert [p.name for p in tmp_path.iterdir()] == ["mine"]
    assert (tmp_path / "mine" / "thesis.tex").read_text() == "years of work"


def contents(path):
    return [p.read_bytes() for p in sorted(path.iterdir() if path.is_dir() else [path])]


@pytest.mark.parametrize("form", ["oem", "csv"])
def test_a_disk_that_fills_up_leaves_what_was_there(run, tmp_path, monkeypatch, form):
    path = export(run, tmp_path / "out", form)
    before = contents(path)

    def full(*_):
        raise OSError(28, "No space left on device", "somewhere within")

    monkeypatch.setattr(sato.export, "format_utc", full)
    with pytest.raises(OSError, match="No space left") as caught:
        export(run, path, form)
    assert caught.value.filename == str(path)
    assert contents(path) == before
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def test_a_place_that_cannot_be_written_is_named(run):
    with pytest.raises(OSError) as caught:
        export(run, "/proc/sato/oem")
    assert caught.value.filename == "/proc/sato/oem"
