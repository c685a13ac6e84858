"""Names, units and ranges that come with numbers: they are obeyed, or refused in a sentence."""

import re
import runpy
import subprocess
import sys
from collections import namedtuple
from dataclasses import replace
from datetime import date, timedelta
from decimal import Decimal
from pathlib import Path

import astropy.units as u
import numpy as np
import pandas as pd
import pint
import pytest
import xarray as xr
from astropy.table import Table
from PIL import Image

import sato
from sato.connectivity.start import as_poses
from sato.connectivity.stick import RecordedStick
from sato.formation.settings import FrameSettings
from sato.scenario.file import read_data
from sato.shapes.formation_library import read_formation, read_graph
from sato.shapes.shape import as_points

ROOT = Path(__file__).parents[1]
FUZZ = runpy.run_path(str(ROOT / "scripts" / "fuzz_labels.py"))
REGISTRY = pint.UnitRegistry()
SQUARE = np.array([[0.0, 0.0], [5.0, 0.0], [5.0, 5.0], [0.0, 5.0]])
Swapped = namedtuple("Swapped", "y x")


def test_drawn_labels_are_obeyed_or_refused():
    # In a process of its own, where the annotations of arguments are not checked.
    script = str(ROOT / "scripts" / "fuzz_labels.py")
    said = subprocess.run(
        [sys.executable, script, "--scale", "0.5"], capture_output=True, text=True
    )
    assert said.returncode == 0, said.stderr
    assert len(re.findall(r"[1-9]\d* read", said.stdout)) == 4
    assert len(re.findall(r"[1-9]\d* refused", said.stdout)) == 3
    assert said.stdout.count("   0 wrong") == 4


# CSV files.


def listed(folder, text, **given):
    path = folder / "points.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return sato.Points(file=str(path), keep_order=True, **given)


@pytest.mark.parametrize(
    ("text", "states"),
    [
        ("y_m,x_m\n0,10\n0,12\n", [[10, 0], [12, 0]]),
        ("Y [km];X (m)\r\n1,5;2,0\r\n3,0;4,0\r\n", [[2, 1500], [4, 3000]]),
        ("# z y x\n1 2 3\n4 5 7\n", [[3, 2, 1], [7, 5, 4]]),
        (",x,y\n1,3,4\n0,1,2\n", [[1, 2], [3, 4]]),
        ("id\tx\ty\n7\t3\t4\n2\t1\t2\n", [[1, 2], [3, 4]]),
        ("sep=;\nx;y\n1;2\n3;4\n", [[1, 2], [3, 4]]),
        ("vy_cm_s,x,y,vx_km_h\n100,0,0,36\n0,1,1,0\n", [[0, 0, 10, 1], [1, 1, 0, 0]]),
        ("1,2,\n3,4,\n,,\n", [[1, 2], [3, 4]]),
        ("# 0,0\n# Team A, Berlin\n1,2\n3,4\n", [[1, 2], [3, 4]]),
        ("# y | x\n1 2\n3 4\n", [[2, 1], [4, 3]]),
        ("# columns: y x\n1,2\n3,4\n", [[2, 1], [4, 3]]),
        ("# Team: A, Berlin, on 2 min of battery\n1,2\n3,4\n", [[1, 2], [3, 4]]),
        ("1,5,6\n", [[1, 5, 6]]),
        ("# flown 2 km away\ny_cm,x_m\n100,2\n", [[2, 1]]),
        ("0,1\n2,1\n", [[0, 1], [2, 1]]),
        ("# x y\n# x | y\nx_m,y_m\n1,2\n", [[1, 2]]),
        ("# LVLH: x radial, y along-track, z cross-track\n1,2\n", [[1, 2]]),
        ("# x right, y up\n1,2\n", [[1, 2]]),
        ("# J2000 epoch, not ECI; x along the runway\nx,y\n1,2\n", [[1, 2]]),
        ("0.0,1.5,2.5\n1.0,3.5,0.5\n", [[0, 1.5, 2.5], [1, 3.5, 0.5]]),
        ("1,0,2\n0,0,2\n", [[1, 0, 2], [0, 0, 2]]),
        ("0,0,5\n1,0,5\n2,0,5\n", [[0, 0, 5], [1, 0, 5], [2, 0, 5]]),
    ],
)
def test_columns_of_a_file_are_read_by_their_names(tmp_path, text, states):
    points, count = listed(tmp_path, text), len(states)
    axes = len(states[0]) if len(states[0]) < 4 else 2
    velocities = points.place_velocities(count, axes)
    placed = points.place(count, axes)
    found = placed if velocities is None else np.hstack([placed, velocities])
    np.testing.assert_allclose(found, states, rtol=1e-15)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x_m,x_m\n0,1\n", 'columns "x_m" and "x_m" are the same'),
        ("x,z\n0,1\n", 'column "y" is missing'),
        ("x,y,vx\n0,1,2\n", 'column "vy" is missing'),
        ("x,y,battery\n0,1,2\n", 'column "battery" is not known'),
        ("north,east,down\n0,1,2\n", 'column "north" is of other axes'),
        ("# north, east\n0,1\n", 'column "north" is of other axes'),
        ("x [ft],y\n0,1\n", r'column "x \[ft\]" has the unit "ft"; km, cm, mm or m would do'),
        ("vx_m,vy_m,x,y\n0,1,2,3\n", 'column "vx_m" has the unit "m"'),
        ("# x,y\n# km,km\n0,1\n", "units have a line of their own"),
        ("x,y\nkm,km\n0,1\n", "line 2: not numbers: km, km"),
        ("x;y\n1,500;2,500\n", "1,500 may be a decimal or thousands"),
        ("x;y\n1,5;2.5\n", "1,5 may be a decimal or thousands"),
        ("id,x,y\n1,0,0\n1,2,2\n", "must number the rows, and has 1 2 times"),
        ("0,1,2,3\n", "2 or 3 columns are needed, or a header such as x,y,z,vx,vy,vz, got 4"),
        ("places\nx,y\n0,1\n", 'column "places" is not known'),
        ("x,y\n1_0,2\n", "line 2: not numbers"),
        ("0,1\n1.5,2.5\n", "0,1 may be names or a point; name the columns, x,y, or write 0.0,1.0"),
        ("# units: km\n1,2\n", 'a comment has the unit "km".* columns are named as in x_mm or'),
        ("# all in millimetres\n1,2\n", 'a comment has the unit "millimetres"'),
        ("# Kilometers\n1,2\n", 'a comment has the unit "Kilometers"'),
        ("# in thousands of meters\n1,2\n", 'a comment has the unit "thousands"'),
        ("# NED frame\n1,2\n", 'a comment speaks of "NED", and a header with x, y and z'),
        ("# frame: ECI J2000\n1,2\n", 'a comment speaks of "ECI", and a header with x, y and z'),
        ("# x along-track\nx,y\n1,2\n", 'a comment speaks of "x along-track", and x is radial'),
        ("# x-axis: along track\nx,y\n1,2\n", 'a comment speaks of "x-axis: along track"'),
        ("# LVLH: x: radial, y = cross-track\n1,2\n", 'a comment speaks of "y = cross-track"'),
        ("x,y\n1,2\n# in inches\n", 'a comment has the unit "inches"'),
        ("# x y in degrees\nx,y\n1,2\n", 'a comment has the unit "degrees"'),
        ("# axes: north east\n1,2\n", 'column "north" is of other axes'),
        ("# in mm\nx,y\n1,2\n", 'a comment has the unit "mm"'),
        ("x [m^-1],y\n1,2\n", "has the unit"),
        ("0,1.5,2.5\n", "first column, 0, 1, …, may number the rows or be x; name the columns"),
        ("0,1.5,2.5\n1,3.5,0.5\n", "id,x,y or x,y,z"),
        ("1,1.5,2.5\n2,3.5,0.5\n", "the first column, 1, 2, …, may number the rows"),
        ("0,3,5\n1,4,5\n2,5,5\n", "may number the rows"),
        ("0.000e+00,3.0,5\n1.000e+00,4.0,5\n", "may number the rows"),
        ("# x y\n# y x\n1 2\n3 4\n", 'two headers disagree; drop the comment "y x"'),
        ("# y,x\nx,y\n1,2\n3,4\n", "two headers disagree"),
        ("# x_km,y_km\nx_m,y_m\n1,2\n", "two headers disagree"),
    ],
)
def test_columns_that_cannot_be_obeyed_are_refused(tmp_path, text, message):
    with pytest.raises(ValueError, match=message):
        listed(tmp_path, text).place(1, 3)


def test_velocities_of_a_file_are_flown_by_those_that_can_move(tmp_path):
    points = listed(tmp_path, "x,y,vx,vy\n0,0,0.1,0\n5,0,0,0.2\n")
    leg = sato.Leg(points, 30)
    mission = FUZZ["make_mission"](start=points, legs=[leg]).draw(np.random.default_rng(0))
    assert mission.agents == 2
    assert mission.initial_states[:, 2:].tolist() == [[0.1, 0.0], [0.0, 0.2]]
    with pytest.raises(ValueError, match="has velocities"):
        read_formation(points.file)
    with pytest.raises(sato.InputError, match="at rest"):
        formation = [sato.FormationLeg("swarm4/Square")]
        listed(tmp_path, "x,y,vx,vy\n0,0,1,0\n5,0,0,0\n0,5,0,0\n5,5,0,0\n")
        sato.Formation(start=points, agents=4, legs=formation).draw(np.random.default_rng(0))
    with pytest.raises(sato.InputError, match="stand in the file too"):
        listed(tmp_path, "x,y,vx,vy\n0,0,0.1,0\n", velocities=[[1.0, 0.0]]).place(1, 2)


def test_recorded_sticks_and_graphs_are_read_by_their_names(tmp_path):
    file = tmp_path / "stick.csv"
    file.write_text("vz;vx_mm_s;time_ms;vy\n1;2000;500;3\n4;5000;1500;6\n")
    stick = RecordedStick(file=str(file)).without_file()
    assert stick.times.tolist() == [0.5, 1.5]
    assert stick.velocities.tolist() == [[2, 3, 1], [5, 6, 4]]
    recorded = xr.DataArray(stick.velocities.T, dims=("axis", "time"))
    assert RecordedStick(times=stick.times, velocities=recorded) == stick
    for header in ("vertex,weight", "i,i", "x,y", "i,j,k"):
        file.write_text(f"{header}\n0,1\n1,2\n2,0\n")
        with pytest.raises(ValueError, match="a header such as vertex,neighbor would do"):
            read_graph(file, 3)


@pytest.mark.parametrize("days", [pd.date_range("2030", periods=2), [date(2030, 1, 1)] * 2])
def test_dates_of_a_recording_are_refused_with_what_would_do(days):
    with pytest.raises(sato.InputError, match=r"times_s: .* seconds since the first of them"):
        RecordedStick(times=days, velocities=np.zeros((2, 3)))


@pytest.mark.parametrize(
    ("text", "edges"),
    [
        ("0,1\n1,2\n2,0\n", 3),
        ("0,1\n2,1\n0,1\n0,2\n", 3),
        ("i,j\n2,1\n0,2\n", 2),
        ("0,1\n2,1\n", 2),
    ],
)
def test_a_first_line_of_a_graph_is_an_edge_where_it_has_numbers(tmp_path, text, edges):
    (file := tmp_path / "graph.csv").write_text(text)
    assert read_graph(file, 3).sum() == 2 * edges


# Quantities.


def test_quantities_become_numbers_in_si_units():
    chief = sato.Chief(semi_major_axis=7000 * u.km, inclination=REGISTRY.Quantity(45, "deg"))
    assert chief == sato.Chief(semi_major_axis=7e6, inclination=np.radians(45))
    assert sato.Loss("random", share=25 * u.percent).share == 0.25
    assert sato.Connectivity(agents=3, duration=timedelta(minutes=2)).duration == 120.0
    assert sato.Connectivity(agents=3, duration=np.timedelta64(5 * 10**9, "ns")).duration == 5.0
    assert sato.Sphere([1 * u.km, 0 * u.m], 1.0).center == (1000.0, 0.0)
    for unit in (u.km, REGISTRY.km):  # 0 is the same in all units
        assert sato.Sphere([0, 1 * unit], 1.0).center == (0.0, 1000.0)
        assert as_points([(0, 1 * unit), (1 * unit, 0)]).positions.tolist() == [[0, 1e3], [1e3, 0]]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: sato.Ring(radius=5 * u.s), r"radius_m: must be a length, got 5\.0 s"),
        (lambda: sato.Ring(radius=REGISTRY.Quantity(5, "s")), "must be a length, got 5 second"),
        (lambda: sato.Loss("random", share=5 * u.m), "share: must be a plain number, in SI units"),
        (
            lambda: sato.Loss("random", share=5 * u.deg),
            "share: must be a plain number, in SI units",
        ),
        (lambda: sato.Points([[1 * u.km, 2.0]]), "numbers with a unit and numbers without"),
        (lambda: as_points(np.ones((3, 4)) * u.m), "one unit for positions and velocities"),
        (lambda: as_points(SQUARE * u.s), "must be a length, got an array in s"),
    ],
)
def test_quantities_of_another_kind_are_refused(make, message):
    with pytest.raises(sato.InputError, match=message):
        make()


def test_quantities_of_other_packages_are_not_stripped():
    class Meters(np.ndarray):
        units = "m"

    for value in (SQUARE.view(Meters), [SQUARE.view(Meters)[0]]):
        with pytest.raises(sato.InputError, match="package that is not known"):
            as_points(value)


@pytest.mark.parametrize("key", ["comm_radius_m", "comm_radius_km", "comm_radius"])
def test_tables_in_python_take_quantities_under_any_unit_of_a_key(key):
    for given in (30 * u.m, REGISTRY.Quantity(0.03, "km")):
        assert FUZZ["read_dict"](key, given).comm_radius == pytest.approx(30.0, rel=1e-15)


@pytest.mark.parametrize("number", [np.int64(2), np.float32(2), np.array(2), 2])
def test_every_number_of_numpy_is_scaled_by_the_unit_of_its_key(number):
    assert FUZZ["read_dict"]("comm_radius_km", number).comm_radius == 2000.0


def test_labels_beside_another_unit_of_a_key_are_refused():
    data = read_data("crossing")
    rows = {"x": [0.0, 5.0], "y": [0.0, 0.0]}
    for table in (rows, pd.DataFrame(rows), pd.DataFrame(rows).to_records(index=False)):
        data["swarm"]["start"] = {"kind": "points", "positions_km": table}
        with pytest.raises(sato.InputError, match="is taken in the SI unit alone"):
            sato.from_dict(data)


# Tables of other packages.


@pytest.mark.parametrize(
    "table",
    [
        pd.DataFrame(SQUARE[:, ::-1], columns=["y", "x"]),
        pd.DataFrame(SQUARE[:, ::-1], columns=["y_m", "x [m]"]).T,
        pd.DataFrame(SQUARE[::-1], columns=["x", "y"], index=pd.Index([3, 2, 1, 0], name="agent")),
        xr.DataArray(SQUARE.T, dims=("axis", "agent")),
        xr.DataArray(SQUARE[:, ::-1], dims=("agent", "axis"), coords={"axis": ["y", "x"]}),
        xr.DataArray(SQUARE[::-1], dims=("agent", "axis"), coords={"agent": [3, 2, 1, 0]}),
        xr.DataArray(SQUARE / 1000, dims=("agent", "axis"), attrs={"units": "km"}),
        xr.DataArray(SQUARE / 1000, dims=("agent", "axis"), attrs={"unit": "km"}),
        xr.Dataset({"y": ("agent", SQUARE[:, 1]), "x": ("agent", SQUARE[:, 0])}),
        {"y": SQUARE[:, 1], "x": SQUARE[:, 0] / 1000 * u.km},
        [Swapped(y, x) for x, y in SQUARE],
        np.rec.fromarrays(SQUARE[:, ::-1].T, names="y,x"),
    ],
    ids=lambda table: type(table).__name__,
)
def test_tables_are_read_by_their_names(table):
    np.testing.assert_allclose(as_points(table).positions, SQUARE, rtol=1e-15)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (pd.DataFrame(SQUARE, columns=["n", "e"]), 'column "n" is of other axes'),
        (pd.DataFrame(SQUARE).iloc[[2, 0, 1]], "index out of order"),
        (pd.DataFrame(SQUARE, [f"agent{i}" for i in (1, 0, 2, 3)], ["x", "y"]), "out of order"),
        (
            xr.DataArray(SQUARE, {"robot": ["r2", "r1", "r3", "r4"], "axis": ["x", "y"]}),
            'labels of "robot" out of order; drop_vars',
        ),
        ([[Decimal(1), Decimal(2)]], r"got an object of type Decimal in it; float\(...\) of it"),
        (pd.DataFrame(SQUARE, columns=["x", "y"]).astype(str), 'column "x" must be'),
        (pd.DataFrame({"x": [1, pd.NaT], "y": [1, 2]}), 'column "x" must be'),
        (xr.DataArray(SQUARE, dims=("a", "b")), "has dimensions a and b"),
        (xr.DataArray(SQUARE[None], dims=("time", "agent", "axis")), r"value\.isel\(time=-1\)"),
        (xr.DataArray(SQUARE[None], dims=("leg", "agent", "axis")), "values in the order of this"),
        (xr.DataArray(SQUARE, dims=("time", "axis")), 'dimensions time and axis; "agent" or "row"'),
        (xr.DataArray(SQUARE, [("time", range(4)), ("axis", ["x", "y"])]), "dimensions time and"),
        (xr.Dataset({"x": ("time", SQUARE[:, 0]), "y": ("time", SQUARE[:, 1])}), "dimensions time"),
        (xr.DataArray(SQUARE, dims=("agent", "axis"), attrs={"units": "m/s"}), "has the unit"),
        ([{"x": 1.0, "y": 2.0}, {"x": 1.0}], "rows of the same names"),
        ({"x": [1.0], "y": [1.0, 2.0]}, "columns of different lengths"),
        (Table({"x": np.ma.array([1.0, 2.0], mask=[0, 1]), "y": [1.0, 2.0]}), "masked rows"),
        (
            xr.DataArray(SQUARE, [("id", range(4)), ("axis", ["x_km", "y"])], attrs={"units": "m"}),
            "unit in its name and in its attrs",
        ),
    ],
)
def test_tables_that_cannot_be_obeyed_are_refused(table, message):
    with pytest.raises(sato.InputError, match=message):
        as_points(table)


def test_positions_of_a_run_are_a_start_of_the_next_mission():
    run = sato.run("crossing")
    ends = run.data.position.isel(time=-1)
    np.testing.assert_array_equal(as_points(ends).positions, ends.values)
    np.testing.assert_array_equal(as_points(ends[:, ::-1]).positions, ends.values)
    with pytest.raises(sato.InputError, match="has the unit"):
        as_points(run.data.velocity.isel(time=-1))


def test_poses_velocities_and_centers_have_named_axes():
    assert as_poses(pd.DataFrame([[1.0, 2, 3]], columns=list("zyx"))).positions.tolist() == [
        [3.0, 2.0, 1.0]
    ]
    moving = pd.DataFrame(SQUARE, columns=["vy_mm_s", "vx"])
    expected = SQUARE[:, ::-1] * [1, 1e-3]
    np.testing.assert_allclose(sato.Points(SQUARE, moving).velocities, expected, rtol=1e-15)
    assert sato.Sphere(pd.Series({"y": 1.0, "x": 2.0}), 1.0).center == (2.0, 1.0)


# Settings.


@pytest.mark.parametrize("overrides", [{"agents": 4}, [("swarm.agents", np.int64(4))]])
def test_overrides_may_be_a_dict_or_pairs(overrides):
    run = sato.run("random", overrides=overrides)
    assert run.data.sizes["agent"] == 4
    assert "swarm.agents = 4" in run.data.attrs["origin"]
    assert run.check().kept


@pytest.mark.parametrize("overrides", [5, [5], [("agents",)], {5: 4}, "agents=4"])
def test_overrides_of_another_kind_are_refused(overrides):
    with pytest.raises(sato.InputError, match=r"overrides(\.0)?: must"):
        sato.run("random", overrides=overrides)
    with pytest.raises(ValueError, match="agents"):
        sato.run("random", overrides={"agents": {1, 2}})


# Pictures.


@pytest.mark.parametrize("high", [1, 15, 255, 4095, 65535])
def test_dark_part_of_a_picture_is_the_same_in_any_range(tmp_path, high):
    y, x = np.mgrid[:60, :80]
    inside = (x - 30) ** 2 + (y - 30) ** 2 < 400
    kinds = [np.uint8] if high < 256 else [np.uint16, np.float32, np.int32]
    for kind in kinds:
        path = tmp_path / "disk.tif"
        Image.fromarray(np.where(inside, 0, high).astype(kind)).save(path)
        assert np.ptp(sato.Picture(str(path)).draw(60, 2).points, axis=0).max() < 40


def test_pictures_of_nearly_one_shade_are_refused(tmp_path):
    rng, path = np.random.default_rng(0), tmp_path / "noise.tif"
    for pixels in (
        rng.integers(250, 256, (20, 20)),
        np.full((20, 20), 3),
        1000 + rng.random((9, 9)),
    ):
        Image.fromarray(pixels.astype(np.float32)).save(path)
        with pytest.raises(ValueError, match="nearly of one shade"):
            sato.Picture(str(path), spacing=1.0).place(5, 2)
    Image.fromarray(np.full((9, 9), np.nan, np.float32)).save(path)
    with pytest.raises(ValueError, match="not finite"):
        sato.Picture(str(path), spacing=1.0).place(5, 2)


def test_a_picture_that_is_nowhere_clear_is_read_by_its_shades(tmp_path):
    gray = np.full((20, 20), 255, np.uint8)
    gray[:, :10] = 0
    bands = [Image.fromarray(band) for band in (gray, gray, gray, np.full_like(gray, 200))]
    path = tmp_path / "veil.png"
    Image.merge("RGBA", bands).save(path)
    assert np.ptp(sato.Picture(str(path), height=20.0).place(50, 2)[:, 0]) < 10


# Ratios and degrees.


def test_ratios_of_separation_that_look_like_meters_are_refused():
    for axes in ((0.6, 1.8), (0.3, 0.3), (2.0, 6.0)):
        with pytest.raises(sato.InputError, match=r"separation_axes_m = .* keeps"):
            FUZZ["make_mission"](separation_axes=axes, collision_radius=0.6)
    for axes in ((1.0, 3.0), (0.8, 1.0)):
        assert FUZZ["make_mission"](separation_axes=axes).ellipsoid == axes


def test_semi_axes_in_meters_are_what_two_keep():
    meters = FUZZ["make_mission"](separation_semi_axes=(0.6, 1.8), collision_radius=0.6)
    ratio = FUZZ["make_mission"](separation_axes=(1.0, 3.0), collision_radius=0.6)
    assert meters.ellipsoid == pytest.approx(ratio.ellipsoid, rel=1e-15)
    assert "separation_axes_m = [" in meters.to_toml()
    assert sato.parse(meters.to_toml()) == meters
    for more in ({"separation_axes": (1.0, 3.0)}, {"collision_radius": (0.6,) * 3 + (0.7,)}):
        with pytest.raises(sato.InputError, match="separation_axes_m"):
            FUZZ["make_mission"](separation_semi_axes=(0.6, 1.8), **more)


def test_angles_beyond_two_turns_are_refused_as_degrees():
    for name in ("inclination", "raan", "arg_perigee", "true_anomaly"):
        with pytest.raises(sato.InputError, match=rf"{name}: .* np\.radians\(45\) = 0\.785398"):
            sato.Orbit.from_elements(7e6, **{name: 45.0})
    for name in ("node", "perigee", "anomaly", "inclination"):
        with pytest.raises(sato.InputError, match=rf"{name}_rad: .* np\.radians\(30\)"):
            sato.Chief(semi_major_axis=7e6, **{name: 30.0})
    with pytest.raises(sato.InputError, match=r"latitude_rad: .* np\.radians\(30\)"):
        sato.Chief(radius=7e6, radial_speed=0.0, angular_momentum=5.3e10, latitude=30.0)
    with pytest.raises(sato.InputError, match=r"yaw_error_rad: .* np\.radians\(10\)"):
        sato.Connectivity(yaw_error=10.0)
    with pytest.raises(sato.InputError, match=r"yaw: .* np\.radians\(90\)"):
        FrameSettings(yaw=np.array([0.0, 90.0, 45.0]))
    assert sato.Orbit.from_elements(7e6, true_anomaly=4 * np.pi).arg_latitude == 4 * np.pi


def test_errors_of_pairs_are_taken_from_the_record_of_a_run_in_any_order():
    errors = np.arange(9.0).reshape(3, 3) / 9
    recorded = xr.DataArray(errors, dims=("agent", "other"), attrs={"units": "rad"})
    for given in (recorded, recorded.T, recorded[::-1].assign_coords(agent=[2, 1, 0])):
        assert np.array_equal(sato.Connectivity(agents=3, yaw_error=given).yaw_error, errors)


def test_an_instant_of_a_run_is_the_start_of_the_next():
    run = sato.run("crossing", overrides=["leg.0.steps=40"])
    last = run.data[["position", "velocity"]].isel(time=-1)
    start = replace(sato.read("crossing"), start=last).initial_states
    assert np.array_equal(start, np.hstack([last["position"], last["velocity"]]))


def test_two_units_of_an_array_are_refused():
    place = xr.DataArray(np.eye(2), dims=("agent", "axis"), attrs={"units": "m"}, name="r [km]")
    for given in (place, place.assign_coords(axis=["x", "y"])):
        with pytest.raises(sato.InputError, match="has a unit in its name and in its attrs"):
            sato.Points(given)


def test_headings_of_frames_are_taken_with_their_unit():
    headings = np.radians([10.0, 20.0, 30.0])
    recorded = xr.DataArray(headings, dims="agent", attrs={"units": "rad"})
    for given in (recorded, [10, 20, 30] * u.deg, headings):
        assert FrameSettings(yaw=given).yaw == pytest.approx(headings)
    with pytest.raises(sato.InputError, match="yaw: must be an angle, got an array in m"):
        FrameSettings(yaw=headings * u.m)


@pytest.mark.parametrize("kind", [pd.Series, xr.DataArray])
def test_the_unit_in_the_name_of_a_column_is_obeyed_or_refused(kind):
    shared = {"model": sato.DoubleIntegrator(2), "start": [[0.0, 0.0], [3.0, 0.0]], "step": 1.0}
    shared |= {"legs": [sato.Leg([[0.0, 3.0], [3.0, 3.0]], 20)], "comm_radius": 9.0}
    shared |= {"collision_radius": 0.5, "max_speed": 0.5}
    for name in ("max_control_cm_s2", "a [cm/s2]", "limit (cm/s²)"):
        mission = sato.Reconfiguration(max_control=kind([20.0, 30.0], name=name), **shared)
        assert mission.max_control == pytest.approx((0.2, 0.3), rel=1e-15)
    for name, unit in {"limit_km": "km", "a [g]": "g", "limit_ft": "ft"}.items():
        with pytest.raises(sato.InputError, match=f'max_control_m_s2: has the unit "{unit}"'):
            sato.Reconfiguration(max_control=kind([1.0, 1.0], name=name), **shared)
    order = sato.Reconfiguration(max_control=0.3, priority=kind([1, 0]), **shared).priority
    assert order == (1, 0)


def test_objects_that_only_look_like_tables_are_refused_in_our_words():
    class Lazy:
        columns = "x", "y"

        def __getitem__(self, name):
            raise TypeError("it is not computed yet")

    with pytest.raises(sato.InputError, match=r"numbers or a table of them, got .* type Lazy"):
        sato.Leg(Lazy(), 20)


# Labels of other things.


def test_labels_of_axes_are_no_vehicles_and_those_of_vehicles_no_axes():
    def fly(**changes):
        leg = sato.Leg(np.array([[0.0, 2], [3, 2]]), 20)
        given = {
            "start": np.array([[0.0, 0.0], [3.0, 0.0]]),
            "step": 1.0,
            "comm_radius": 20.0,
            "collision_radius": 0.5,
            "max_control": 0.5,
        }
        model = sato.DoubleIntegrator(2)
        more = {"max_speed": 1.0} | given | changes
        return sato.Reconfiguration(model=model, legs=[leg], **more)

    axes, agents = (xr.DataArray([0.1, 0.2], dims=dim) for dim in ("axis", "agent"))
    for wrong in ({"x": 0.1, "y": 0.2}, pd.Series({"vx": 0.1, "vy": 0.2}), axes):
        with pytest.raises(
            sato.InputError, match=r"has the labels (x and y|vx and vy|axis); a list"
        ):
            fly(max_control=wrong)
    assert fly(max_control=agents).max_control == (0.1, 0.2)
    numbered = pd.Series([0.1, 0.2], pd.Index([7, 3], name="id"))
    assert fly(max_control=numbered).max_control == (0.2, 0.1)  # as rows of a start would be
    with pytest.raises(sato.InputError, match="must not be a masked array"):
        fly(max_control=np.ma.array([0.1, 0.2], mask=[0, 1]))
    with pytest.raises(sato.InputError, match="must not be a masked array"):
        fly(start=list(np.ma.array([[0.0, 0], [3, 0]], mask=[[0, 0], [1, 0]])))
    with pytest.raises(sato.InputError, match='has the dimension agent, and an entry an axis; "ax'):
        fly(max_control=None, max_control_axes=agents)
    assert sato.Sphere(axes, 1.0).center == (0.1, 0.2)


@pytest.mark.parametrize("labels", [list("abcd"), range(1, 5), range(4)])
def test_a_labeled_graph_of_points_without_labels_is_taken(labels):
    graph = pd.DataFrame(1 - np.eye(4, dtype=int), labels, labels)
    frame = pd.DataFrame(SQUARE, columns=["x", "y"])
    array = xr.DataArray(SQUARE.T, [("axis", ["x", "y"]), ("agent", list(labels))])
    plain = sato.FormationLeg(SQUARE, graph.to_numpy())
    for points in (frame, frame.T, frame.assign(id=range(1, 5)), array, SQUARE):
        assert sato.FormationLeg(points, graph) == plain


@pytest.mark.parametrize("weight", [0.3, -1.0, 1e-17, 2.0])
def test_a_matrix_of_other_numbers_than_0_and_1_is_no_graph(weight):
    with pytest.raises(
        sato.InputError, match="graph: must be a symmetric matrix of True and False"
    ):
        sato.FormationLeg(SQUARE, weight * (1 - np.eye(4)))


@pytest.mark.parametrize("dims", [("dim_0", "dim_1"), ("row", "id"), ("agent", "axis")])
def test_names_of_axes_are_obeyed_on_any_dimension(dims):
    swapped = xr.DataArray(SQUARE[:, ::-1], dims=dims, coords={dims[1]: ["y", "x"]})
    np.testing.assert_array_equal(as_points(swapped).positions, SQUARE)


def test_a_graph_labeled_in_another_order_than_the_points_is_refused():
    names, rng = list("abcdef"), np.random.default_rng(0)
    points = pd.DataFrame(rng.uniform(0, 20, (6, 3)), names, ["x", "y", "z"])
    graph = pd.DataFrame(1 - np.eye(6, dtype=int), names, names)
    graph.loc["a", "b"] = graph.loc["b", "a"] = 0
    plain = sato.FormationLeg(points, graph.to_numpy())
    other = names[::-1]
    labeled = xr.DataArray(graph.loc[other, other], dims=("agent", "neighbor"))
    for wrong in (graph.loc[other, other], graph.loc[other], graph[other], labeled):
        with pytest.raises(sato.InputError, match="graph: has rows or columns labeled in another"):
            sato.FormationLeg(points, wrong)
    assert sato.FormationLeg(points, graph.to_numpy(dtype=float)) == plain
    assert sato.FormationLeg(points, graph) == plain == sato.FormationLeg(points.values, graph)
