"""Read labels drawn at random against a truth of this script: python scripts/fuzz_labels.py.

CSV files whose columns are shuffled, renamed, in other units and separators; quantities of astropy
and pint; frames of pandas, arrays of xarray and their like; pictures of all ranges of numbers. Each
is read as it was meant, or refused in a sentence. Faulty ones are refused. Exit code 1, and the
case, where one is not.
"""

import argparse
import contextlib
import importlib
import io
import sys
import tempfile
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.random import Generator

import sato
from problems.desired_formation import DesiredFormation
from sato.connectivity.mission import RecordedStick
from sato.formation.settings import FrameSettings
from sato.scenario.file import read_data
from sato.shapes.formation_library import read_formation, read_graph
from sato.shapes.shape import as_points

SIZES = {"m": 1.0, "km": 1e3, "cm": 1e-2, "mm": 1e-3, "": 1.0}
SPEEDS = {"m_s": 1.0, "mm_s": 1e-3, "km_s": 1e3, "cm_s": 1e-2, "km_h": 1 / 3.6, "": 1.0}
SYMBOLS = {"m_s": "m/s", "mm_s": "mm/s", "km_s": "km/s", "cm_s": "cm/s", "km_h": "km/h"}
AXES = "xyz"


class Case(NamedTuple):
    """Something to read, the numbers that it means, None for a faulty one, and what it is."""

    read: Callable[[], Any]
    truth: Any
    text: str
    must_read: bool = False


# CSV files.


def spell(name: str, unit: str, rng: Generator) -> str:
    """Draw a spelling of the name of a column."""
    axis, written = name[-1], SYMBOLS.get(unit, unit)
    bases = [name]
    if name in AXES:
        bases += [f"pos_{axis}", f"position_{axis}", f"p{axis}", f"{axis}_pos", f"pos.{axis}"]
    elif name != "t":
        bases += [f"v_{axis}", f"vel_{axis}", f"velocity_{axis}", f"{axis}_dot", f"{axis}dot"]
    else:
        bases += ["time", "timestamp"]
    base = str(rng.choice(bases))
    if not unit:
        forms = [base]
    else:
        forms = [f"{base}_{unit}", f"{base} [{written}]", f"{base} ({written})", f"{base}[{unit}]"]
        forms += [f"{base}/{written}"] if "/" not in written else []
    form = str(rng.choice(forms))
    if rng.random() < 0.15 and unit in ("", "m", "km", "m_s", "mm_s", "s"):
        form = form.upper()
    return f" {form} " if rng.random() < 0.2 else form


def draw_columns(
    rng: Generator, names: list[str], rows: int
) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Draw headers, the numbers of a file, and what they mean in SI units."""
    headers, columns, truth = [], [], []
    for name in names:
        sizes = {"t": {"s": 1.0, "ms": 1e-3, "min": 60.0, "": 1.0}}.get(
            name, SIZES if name in AXES else SPEEDS
        )
        unit = str(rng.choice(list(sizes)))
        if name == "t":
            number = np.round(np.cumsum(rng.uniform(0.1, 5, rows)), 3)
        else:
            number = np.round(rng.uniform(-9, 9, rows), 3) + 0.0001 * np.arange(rows)
        headers.append(spell(name, unit, rng))
        columns.append(number)
        truth.append(number * sizes[unit])
    return headers, np.stack(columns, axis=1), np.stack(truth, axis=1)


def write(path: Path, headers: list[str] | None, numbers: Any, rng: Generator) -> str:
    """Write a file with a drawn separator and drawn blemishes."""
    between = str(rng.choice([",", ";", "\t", ", "]))
    is_decimal_comma = between in ";\t" and rng.random() < 0.3
    rows = [[f"{x:.10g}" if float(x) != int(x) else f"{x:.0f}" for x in row] for row in numbers]
    if is_decimal_comma:
        rows = [[cell.replace(".", ",") for cell in row] for row in rows]
    if headers is not None and rng.random() < 0.2:
        headers = [f'"{name.strip()}"' for name in headers]
    end = str(rng.choice(["\n", "\r\n"]))
    tail = between.strip() or between if rng.random() < 0.15 else ""
    lines = [between.join(row) + tail for row in rows]
    if headers is not None:
        mark = "# " if between == "," and rng.random() < 0.15 else ""
        lines.insert(0, mark + between.join(headers) + ("" if mark else tail))
    if rng.random() < 0.2:
        lines.insert(0, "# targets of the second show")
    if rng.random() < 0.2:
        lines.insert(int(rng.integers(len(lines) + 1)), "")
    if between == ";" and rng.random() < 0.2:
        lines.insert(0, "sep=;")
    text = end.join(lines) + end
    path.write_bytes((b"\xef\xbb\xbf" if rng.random() < 0.2 else b"") + text.encode())
    return text


def draw_csv(rng: Generator, folder: Path, number: int) -> Case:
    """Draw a CSV file of points, states, a formation, a stick or a graph."""
    path = folder / f"{number}.csv"
    kind = str(
        rng.choice(
            ["points", "states", "formation", "stick", "graph"], p=[0.35, 0.3] + [0.12] * 2 + [0.11]
        )
    )
    d, rows = int(rng.integers(2, 4)), int(rng.integers(4, 8))
    if kind == "graph":
        return draw_graph(rng, path, rows)
    axes = list(AXES[:d])
    names = {"stick": ["t", "vx", "vy", "vz"], "states": axes + [f"v{a}" for a in axes]}.get(
        kind, axes
    )
    headers, numbers, truth = draw_columns(rng, names, rows)
    fault = str(rng.choice(list(FAULTS))) if rng.random() < 0.35 else ""
    order = rng.permutation(len(names))
    headers, numbers = [headers[i] for i in order], numbers[:, order]
    if kind != "stick" and not fault and rng.random() < 0.3:
        first, place = int(rng.integers(2)), int(rng.integers(len(names) + 1))
        ids = rng.permutation(rows)
        headers.insert(place, str(rng.choice(["id", "agent", "Vehicle", "drone_id", "index"])))
        numbers = np.insert(numbers, place, ids + first, axis=1)
        truth = truth[np.argsort(ids)]
    if fault:
        found = FAULTS[fault](headers, numbers, rng)
        headers, numbers = found
    text = write(path, headers, numbers, rng) if not isinstance(numbers, str) else numbers
    if isinstance(numbers, str):
        path.write_text(numbers)

    def read() -> Any:
        if kind == "stick":
            stick = RecordedStick(file=str(path)).without_file()
            return np.column_stack([stick.times, stick.velocities])
        if kind == "formation":
            return read_formation(path).points[:, : truth.shape[1]]
        points = sato.Points(file=str(path), keep_order=True)
        velocity = points.place_velocities(len(truth), d)
        placed = points.place(len(truth), d)
        return placed if velocity is None else np.hstack([placed, velocity])

    return Case(read, None if fault else truth, f"{kind} {fault}\n{text}", not fault)


def draw_graph(rng: Generator, path: Path, rows: int) -> Case:
    """Draw a CSV file of edges."""
    truth = np.zeros((rows, rows), dtype=bool)
    i, j = np.nonzero(np.triu(rng.random((rows, rows)) < 0.6, 1))
    truth[i, j] = truth[j, i] = True
    faults: list[list[str]] = [["x", "y"], ["i", "i"], ["vertex", "weight"], ["from", "distance_m"]]
    names: list[list[str]] = [
        ["vertex", "neighbor"],
        ["i", "j"],
        ["source", "target"],
        ["From", "To"],
    ]
    is_faulty = rng.random() < 0.3 or not len(i)
    chosen = (faults if is_faulty else names)[int(rng.integers(4))]
    text = "\n".join([",".join(chosen), *(f"{a},{b}" for a, b in zip(i, j, strict=True))])
    path.write_text(text + "\n")
    return Case(lambda: read_graph(path, rows), None if is_faulty else truth, text, not is_faulty)


Faulty = tuple[list[str], Any]


def _insert(name: str) -> Callable[[list[str], Any, Generator], Faulty]:
    def fault(headers: list[str], numbers: Any, rng: Generator) -> Faulty:
        place = int(rng.integers(len(headers) + 1))
        return [*headers[:place], name, *headers[place:]], np.insert(numbers, place, 7.0, axis=1)

    return fault


def _replace(*names: str) -> Callable[[list[str], Any, Generator], Faulty]:
    def fault(headers: list[str], numbers: Any, rng: Generator) -> Faulty:
        return [*headers[: max(len(headers) - len(names), 0)], *names][: len(headers)], numbers

    return fault


def _text(make: Callable[[str], str]) -> Callable[[list[str], Any, Generator], Faulty]:
    def fault(headers: list[str], numbers: Any, rng: Generator) -> Faulty:
        rows = [",".join(f"{x:.6g}" for x in row) for row in numbers]
        return headers, make("\n".join([",".join(headers), *rows]) + "\n")

    return fault


def _repeat(headers: list[str], numbers: Any, rng: Generator) -> Faulty:
    return [headers[0], *headers[:-1]], numbers


def _drop(headers: list[str], numbers: Any, rng: Generator) -> Faulty:
    kept = [i for i, name in enumerate(headers) if "y" not in name.lower()]
    return [headers[i] for i in kept], numbers[:, kept]


FAULTS: dict[str, Callable[[list[str], Any, Generator], Faulty]] = {
    "repeated": _repeat,
    "missing": _drop,
    "unknown": _insert("battery"),
    "name": _insert("name"),
    "yaw": _insert("yaw_deg"),
    "blank": lambda h, n, r: _insert("")(h, n, np.random.default_rng(5)),
    "latitude": _replace("lat", "lon"),
    "NED": _replace("north", "east", "down"),
    "NED short": _replace("n", "e", "d"),
    "RTN": _replace("radial", "along_track", "cross_track"),
    "RTN short": _replace("r", "t", "n"),
    "ENU": _replace("east", "north", "up"),
    "wrong quantity": _replace("x_s"),
    "unknown unit": _replace("y [ft]"),
    "not a speed": _replace("vx_m"),
    "title first": _text(lambda text: "targets of the show\n" + text),
    "header second": _text(lambda text: "1,2\n" + text),
    "units in a line": _text(lambda text: text.replace("\n", "\n" + ",".join(["m"] * 9) + "\n", 1)),
    "thousands": _text(lambda text: "x;y\n1,500;2,250\n3,125;4,750\n"),
    "both decimals": _text(lambda text: "x;y\n1,5;2.5\n3,5;4.5\n"),
    "a word": _text(lambda text: text.rstrip("\n") + "x\n"),
    "a short row": _text(lambda text: text + "1\n"),
    "not a number": _text(lambda text: text.split("\n")[0] + "\n" + ",".join(["nan"] * 2) + "\n"),
    "id twice": _text(lambda text: "id,x,y\n1,0,0\n1,2,0\n3,4,0\n5,6,0\n"),
    "id is text": _text(lambda text: "id,x,y\na,0,0\nb,2,0\nc,4,0\n"),
    "no velocity of y": _text(lambda text: "x,y,vx\n0,0,1\n2,0,1\n4,0,1\n5,6,1\n"),
}


# Quantities.

FIELDS: list[tuple[str, str, Callable[[Any], Any]]] = [
    ("m", "comm_radius", lambda q: make_mission(comm_radius=q).comm_radius),
    ("m", "collision_radius", lambda q: make_mission(collision_radius=[q] * 4).collision_radius[0]),
    ("m/s2", "max_control", lambda q: make_mission(max_control=q).max_control),
    ("m/s", "max_speed", lambda q: make_mission(max_speed=q).max_speed),
    ("s", "step", lambda q: make_mission(step=q).step),
    ("m", "margin", lambda q: make_mission(margin=q).margin),
    ("", "tie_break", lambda q: make_mission(thrust_error=q).thrust_error),
    ("m", "Ring.radius", lambda q: sato.Ring(radius=q).radius),
    ("m", "Sphere.radius", lambda q: sato.Sphere((0.0, 0.0), q).radius),
    ("m", "Sphere.center", lambda q: sato.Sphere([q, q], 1.0).center[1]),
    ("m/s", "Sphere.velocity", lambda q: sato.Sphere((0, 0), 1.0, velocity=[q, q]).velocity[0]),
    (
        "rad",
        "Chief.inclination",
        lambda q: sato.Chief(semi_major_axis=7e6, inclination=q).inclination,
    ),
    (
        "rad",
        "Orbit.inclination",
        lambda q: sato.Orbit.from_elements(7e6, inclination=q).inclination,
    ),
    ("rad", "Orbit.raan", lambda q: sato.Orbit.from_elements(7e6, raan=q).raan),
    ("", "Orbit.eccentricity", lambda q: sato.Orbit.from_elements(9e7, q).eccentricity),
    ("m", "from_dict", lambda q: read_dict("comm_radius_m", q).comm_radius),
    ("m", "from_dict, km", lambda q: read_dict("comm_radius_km", q).comm_radius),
    ("m", "from_dict, bare", lambda q: read_dict("comm_radius", q).comm_radius),
    ("s", "duration", lambda q: sato.Connectivity(duration=q, agents=3).duration),
    ("m", "frames.offset", lambda q: FrameSettings(offset=q).offset),
]
ARRAYS: list[tuple[str, str, Callable[[Any], Any]]] = [
    ("m", "start", lambda q: make_mission(start=q).start.positions),
    ("m", "target", lambda q: sato.Leg(q, 30).shape.positions),
    ("m", "Points", lambda q: sato.Points(q).positions),
    ("m/s", "Points.velocities", lambda q: sato.Points(np.eye(4)[:, :2], q).velocities),
    ("m", "Polygon", lambda q: sato.Polygon(q, height=None).vertices),
    ("m", "Formation.start", lambda q: as_points(q).positions),
    ("m", "box", lambda q: sato.Polytope(q).points),
    ("m", "DesiredFormation", lambda q: read_square(q)),
]
UNITS = {
    "m": {"m": 1.0, "km": 1e3, "cm": 1e-2, "mm": 1e-3, "au": 149597870700.0},
    "m/s": {"m/s": 1.0, "km/s": 1e3, "mm/s": 1e-3, "km/h": 1 / 3.6},
    "m/s2": {"m/s**2": 1.0, "mm/s**2": 1e-3, "cm/s**2": 1e-2},
    "s": {"s": 1.0, "ms": 1e-3, "min": 60.0, "hour": 3600.0},
    "rad": {"rad": 1.0, "deg": np.pi / 180, "arcmin": np.pi / 10800},
    "": {"": 1.0},
}


def read_dict(key: str, value: Any) -> Any:
    """Read a mission with a value in its table."""
    data = read_data("crossing")
    data["plan"]["allow_undetectable"] = True
    data["swarm"] = {k: v for k, v in data["swarm"].items() if not k.startswith("comm_radius")}
    data["swarm"][key] = value
    return sato.from_dict(data)


def read_square(value: Any) -> Any:
    """Return the points of a formation with heights of 0."""
    unit = getattr(value, "unit", getattr(value, "units", 1))
    flat = np.zeros((len(value), 1)) * unit
    return DesiredFormation.with_complete_graph(np.concatenate([value, flat], axis=1)).points[:, :2]


def make_mission(**changed: Any) -> Any:
    """Make a small mission."""
    start = np.array([[0.0, 0], [5, 0], [0, 5], [5, 5]])
    plain = {"model": sato.DoubleIntegrator(2), "start": start, "legs": [sato.Leg(start, 30)]}
    radii = {"step": 1.0, "comm_radius": 50.0, "collision_radius": 0.5, "allow_undetectable": True}
    return sato.Reconfiguration(
        **(plain | radii | {"max_control": 0.5, "max_speed": 1.0} | changed)
    )


def draw_quantity(rng: Generator, folder: Path, number: int) -> Case:
    """Draw a quantity for a field or an array."""
    is_array = rng.random() < 0.35
    kinds = ARRAYS if is_array else FIELDS
    dimension, name, read = kinds[int(rng.integers(len(kinds)))]
    is_wrong = rng.random() < 0.35
    given = str(rng.choice([d for d in UNITS if d != dimension])) if is_wrong else dimension
    unit, size = list(UNITS[given].items())[int(rng.integers(len(UNITS[given])))]
    corners = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]]) * 3 + [[0.5, 0.25]]
    # Numbers in the unit that are small in SI units, within the range of every field.
    number_of = (corners if is_array else float(np.round(rng.uniform(0.2, 0.9), 3))) / size
    package = str(rng.choice(["astropy", "pint"]))
    if package == "astropy":
        units = importlib.import_module("astropy.units")
        quantity = number_of * units.Unit(unit.replace("hour", "h"))
    else:
        quantity = REGISTRY.Quantity(number_of, unit)
    truth = None if is_wrong else number_of * size
    return Case(lambda: read(quantity), truth, f"{name} = {quantity!r}", not is_wrong)


# Frames.


def draw_frame(rng: Generator, folder: Path, number: int) -> Case:
    """Draw a table of states or positions of one of many kinds."""
    d, n = int(rng.integers(2, 4)), int(rng.integers(3, 7))
    names = list(AXES[:d]) + ([f"v{a}" for a in AXES[:d]] if rng.random() < 0.4 else [])
    headers, numbers, truth = draw_columns(rng, names, n)
    headers = [name.strip() for name in headers]
    order = rng.permutation(len(names))
    headers, numbers = [headers[i] for i in order], numbers[:, order]
    kind = str(rng.choice(list(FRAMES)))
    value, truth = FRAMES[kind](headers, numbers, truth, rng)
    return Case(lambda: states_of(as_points(value)), truth, f"{kind}\n{value!r}", truth is not None)


def states_of(points: Any) -> Any:
    """Return positions, and velocities beside them."""
    v = points.velocities
    return points.positions if v is None else np.hstack([points.positions, v])


def _pandas(headers: list[str], numbers: Any, truth: Any, rng: Generator) -> Any:
    frame = importlib.import_module("pandas").DataFrame(numbers, columns=headers)
    if rng.random() < 0.4:
        ids = rng.permutation(len(frame))
        frame.index = importlib.import_module("pandas").Index(ids, name="agent")
        truth = truth[np.argsort(ids)]
    return (frame if rng.random() < 0.7 else frame.T.T), truth


def _pandas_faulty(headers: list[str], numbers: Any, truth: Any, rng: Generator) -> Any:
    pandas = importlib.import_module("pandas")
    frame = pandas.DataFrame(numbers, columns=headers)
    faults = [
        lambda: frame.rename(columns={headers[0]: "north"}),
        lambda: frame.rename(columns={headers[0]: headers[1]}),
        lambda: frame.drop(columns=headers[0]),
        lambda: frame.assign(battery=1.0),
        lambda: frame.assign(**{headers[0]: "a"}),
        lambda: frame.assign(**{headers[0]: np.nan}),
        lambda: frame.assign(**{headers[0]: pandas.Timestamp("2026-01-01")}),
        lambda: frame.set_index(pandas.date_range("2026", periods=len(frame))),
        lambda: frame.set_index(pandas.Index(range(len(frame)), name="time")),
        lambda: frame.set_index(pandas.MultiIndex.from_product([[1], range(len(frame))])),
        lambda: frame.astype("Float64").mask(frame > 0),
        lambda: pandas.DataFrame(numbers[:, [1, 0]], columns=[1, 0]),
        lambda: frame.sample(frac=1, random_state=3).iloc[::-1] if len(frame) > 2 else None,
    ]
    return faults[int(rng.integers(len(faults) - 1))](), None


def _xarray(headers: list[str], numbers: Any, truth: Any, rng: Generator) -> Any:
    xarray = importlib.import_module("xarray")
    coords = {"axis": headers}
    if rng.random() < 0.5:
        ids = rng.permutation(len(numbers))
        coords["agent"] = ids
        truth = truth[np.argsort(ids)]
    array = xarray.DataArray(numbers, dims=("agent", "axis"), coords=coords)
    return (array.T if rng.random() < 0.5 else array), truth


def _xarray_plain(headers: list[str], numbers: Any, truth: Any, rng: Generator) -> Any:
    xarray = importlib.import_module("xarray")
    unit = str(rng.choice(["m", "km", "mm"]))
    dims = str(rng.choice(["agent", "drone"])), str(rng.choice(["axis", "coordinate", "xyz"]))
    array = xarray.DataArray(numbers[:, :2], dims=dims, attrs={"units": unit})
    return (array.T if rng.random() < 0.5 else array), numbers[:, :2] * SIZES[unit]


def _xarray_faulty(headers: list[str], numbers: Any, truth: Any, rng: Generator) -> Any:
    xarray = importlib.import_module("xarray")
    flat = numbers[:, :2]
    faults = [
        lambda: xarray.DataArray(flat, dims=("foo", "bar")),
        lambda: xarray.DataArray(flat, dims=("x", "y")),
        lambda: xarray.DataArray(flat, dims=("agent", "axis"), coords={"axis": ["n", "e"]}),
        lambda: xarray.DataArray(flat, dims=("agent", "axis"), attrs={"units": "s"}),
        lambda: xarray.DataArray(flat, dims=("agent", "axis"), attrs={"units": "ft"}),
        lambda: xarray.DataArray(flat, dims=("agent", "axis"), coords={"agent": [0] * len(flat)}),
        lambda: xarray.DataArray(flat, dims=("agent", "time")),
    ]
    return faults[int(rng.integers(len(faults)))](), None


def _dataset(headers: list[str], numbers: Any, truth: Any, rng: Generator) -> Any:
    xarray = importlib.import_module("xarray")
    columns = {name: ("agent", numbers[:, i]) for i, name in enumerate(headers)}
    return xarray.Dataset(columns), truth


def _structured(headers: list[str], numbers: Any, truth: Any, rng: Generator) -> Any:
    array = np.array([tuple(row) for row in numbers], dtype=[(name, float) for name in headers])
    return (array if rng.random() < 0.5 else array.view(np.recarray)), truth


def _dicts(headers: list[str], numbers: Any, truth: Any, rng: Generator) -> Any:
    if rng.random() < 0.5:
        return dict(zip(headers, numbers.T, strict=True)), truth
    return [dict(zip(headers, row, strict=True)) for row in numbers.tolist()], truth


def _astropy(headers: list[str], numbers: Any, truth: Any, rng: Generator) -> Any:
    table = importlib.import_module("astropy.table").QTable()
    units = importlib.import_module("astropy.units")
    for name, column in zip(["y", "x"], numbers.T, strict=False):
        table[name] = column * units.km
    return table, numbers[:, [1, 0]] * 1e3


def _other(module: str, make: str) -> Callable[..., Any]:
    def build(headers: list[str], numbers: Any, truth: Any, rng: Generator) -> Any:
        with contextlib.suppress(ModuleNotFoundError):
            kind = getattr(importlib.import_module(module), make)
            return kind(dict(zip(headers, numbers.T, strict=True))), truth
        return _dicts(headers, numbers, truth, rng.spawn(1)[0])  # other draws stay as they are

    return build


FRAMES: dict[str, Callable[..., Any]] = {
    "pandas": _pandas,
    "pandas, faulty": _pandas_faulty,
    "xarray": _xarray,
    "xarray, no names": _xarray_plain,
    "xarray, faulty": _xarray_faulty,
    "dataset": _dataset,
    "structured": _structured,
    "dicts": _dicts,
    "astropy table": _astropy,
    "polars": _other("polars", "DataFrame"),
    "pyarrow": _other("pyarrow", "table"),
}


# Pictures.


def draw_picture(rng: Generator, folder: Path, number: int) -> Case:
    """Draw a dark ellipse, in a picture of any range of numbers."""
    image = importlib.import_module("PIL.Image")
    height, width = (int(k) for k in rng.integers(40, 90, 2))
    y, x = np.mgrid[:height, :width]
    a, b = width * rng.uniform(0.2, 0.4), height * rng.uniform(0.2, 0.4)
    inside = ((x - width / 2) / a) ** 2 + ((y - height / 2) / b) ** 2 < 1
    kind = str(rng.choice(["L", "16", "F", "I", "1", "P", "LA", "RGBA", "CMYK"]))
    path = folder / f"{number}.{'tif' if kind in ('F', 'I', 'CMYK') else 'png'}"
    if kind in ("16", "F", "I"):
        high = {"16": 2.0 ** rng.integers(1, 17) - 1, "F": 10.0 ** rng.integers(-2, 6), "I": 1e5}[
            kind
        ]
        dtype = {"16": np.uint16, "F": np.float32, "I": np.int32}[kind]
        picture = image.fromarray(np.where(inside, 0, high).astype(dtype))
    elif kind in ("LA", "RGBA"):
        alpha = image.fromarray(np.where(inside, 255, 0).astype(np.uint8))
        gray = image.fromarray(np.full_like(y, rng.integers(256), dtype=np.uint8))
        picture = image.merge(kind, [gray] * (len(kind) - 1) + [alpha])
    else:
        bright = {"1": 255}.get(kind, int(rng.choice([1, 15, 255])) if kind == "L" else 255)
        plain = image.fromarray(np.where(inside, 0, bright).astype(np.uint8))
        picture = plain.convert("RGB").convert(kind) if kind == "CMYK" else plain.convert(kind)
    picture.save(path)
    rows, columns = np.nonzero(inside)
    truth = np.array([np.ptp(columns) + 1.0, np.ptp(rows) + 1.0])

    def read() -> Any:
        return np.ptp(sato.Picture(str(path)).draw(200, 2).points, axis=0)

    return Case(read, truth, f"{kind} {picture.getextrema()}", True)


DRAWN: dict[str, tuple[Callable[[Generator, Path, int], Case], int, float]] = {
    "csv": (draw_csv, 200, 1e-12),
    "quantities": (draw_quantity, 60, 1e-12),
    "frames": (draw_frame, 30, 1e-12),
    "pictures": (draw_picture, 30, 0.08),
}
REGISTRY: Any = None


def draw_cases(kind: str, count: int, seed: int, folder: Path) -> Iterator[Case]:
    """Draw cases of a kind."""
    global REGISTRY
    if kind == "quantities" and REGISTRY is None:
        REGISTRY = importlib.import_module("pint").UnitRegistry()
    rng = np.random.default_rng([seed, list(DRAWN).index(kind)])
    for number in range(count):
        yield DRAWN[kind][0](rng, folder, number)


def judge(case: Case, tolerance: float) -> str:
    """Read a case; return "read", "refused", or what is wrong."""
    try:
        found = case.read()
    except ValueError as error:
        sentence = str(error)
        if not isinstance(error, sato.InputError | sato.ScenarioError) and "numpy" in sentence:
            return f"wrong: raw: {sentence}"
        return "refused" if not case.must_read else f"wrong: refused: {sentence}"
    except Exception:
        return f"wrong: raised:\n{traceback.format_exc()}"
    if case.truth is None:
        return f"wrong: taken, and read as\n{found}"
    is_same = np.shape(found) == np.shape(case.truth) and np.allclose(
        found, case.truth, rtol=tolerance, atol=0
    )
    return "read" if is_same else f"wrong: read as\n{found}\nand meant is\n{case.truth}"


def main() -> int:
    """Draw, judge and count."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--scale", type=float, default=1.0, help="times the cases of each kind")
    parser.add_argument("--verbose", action="store_true", help="show each refusal")
    options = parser.parse_args()
    wrong = 0
    with tempfile.TemporaryDirectory() as name:
        for kind, (_, count, tolerance) in DRAWN.items():
            counts: Counter[str] = Counter()
            for case in draw_cases(kind, round(count * options.scale), options.seed, Path(name)):
                said = judge(case, tolerance)
                counts[said.split(":")[0]] += 1
                if said.startswith("wrong"):
                    print(f"{kind}: {case.text}\n{said}\n", file=sys.stderr)
                if options.verbose and said == "refused":
                    with contextlib.suppress(Exception), contextlib.redirect_stderr(io.StringIO()):
                        case.read()
            wrong += counts["wrong"]
            row = (f"{counts[what]:5} {what}" for what in ("read", "refused", "wrong"))
            print(f"{kind:12} {' '.join(row)}")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
