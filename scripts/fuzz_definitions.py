"""Send random missions through files, copies and flights: python scripts/fuzz_definitions.py.

Every field of every definition that the three systems may hold is varied in turn, some values
replaced by objects of the user's own. What comes back from TOML, pickle, deepcopy, replace, and of
every 50th from a saved run, is equal, or refused with a reason, or named as skipped.
Exit code 1, and what differs, where it is not, or where a field was never kept.
"""

import argparse
import copy
import pickle
import sys
import tempfile
import tomllib
import warnings
from collections import Counter
from collections.abc import Iterator
from dataclasses import MISSING, fields, is_dataclass, replace
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, get_args, get_origin

import numpy as np
from numpy.random import Generator

import sato
from dynamics.model import Model
from dynamics.plant import Plant
from problems.desired_formation import DesiredFormation
from sato.scenario.definition import Field, fields_of, is_definition, is_named_tuple
from sato.scenario.file import Mission, describe_own
from sato.scenario.table import find_own

MOVED = {"Poses.yaw"}  # fields that become others: here the yaw of the mission
TRIES = 40  # draws of a value before a field counts as refused
OWN_SHARE = 0.15  # of missions with a value of the user's own
NUMBERS = (0.0, -0.0, 1.0, 1 / 3, 1e-30, 1e-9, 1e6, 3, 2, 7, np.float64(0.1), np.float32(0.1))
NUMBERS += (np.int64(4), float("inf"), 0.1 + 0.2, 5e-324, 123456789.123456789)
TEXTS = (
    "Ω λ₂",
    'a "b" \\c',
    "tab\tnew\nline",
    "\x07",
    "none",
    "",
    "mine",
    "U",
    "'''",
    "true",
    "a.b",
)
FILES: dict[str, str] = {}  # by class


class Damped(sato.LinearModel):
    """Point mass with friction."""

    axes = 2

    def __init__(self, friction: float) -> None:
        self.friction = np.array([friction])

    def A(self, t: Any) -> Any:
        """State matrix."""
        zero = np.zeros((2, 2))
        return np.block([[zero, np.eye(2)], [zero, -self.friction[0] * np.eye(2)]])


class Euler(sato.Plant):
    """One step of Euler's method for a double integrator."""

    def __init__(self, friction: float = 0.0) -> None:
        self.friction = friction

    def propagate(self, x: Any, u: Any, t: float, dt: float, substeps: int = 1) -> Any:
        """Return the states at equal instants from t to t + dt, the first of them x itself."""
        states = [x]
        for _ in range(substeps):
            d, h = x.shape[1] // 2, dt / substeps
            v = x[:, d:]
            x = x + h * np.hstack([v + h * u / 2, u - self.friction * v])
            states.append(x)
        return np.array(states)


def draw_together(what: str, axes: int, rng: Generator) -> dict[str, Any]:
    """Draw values that a definition takes together alone, for a field of it; or none."""
    x, several = float(rng.uniform(0.05, 0.3)), tuple(rng.uniform(0.1, 0.3, axes).tolist())
    drag = {"drag": True, "ballistic": x, "ballistic_spread": x, "chief_ballistic": x}
    air = {"density": 1e-12 * x, "altitude": 4e5 * x, "scale_height": 5e4 * x}
    box = np.array([[0.0, 0, 3], [2, 0, 3], [0, 2, 3], [2, 2, 3], [4, 0, 3.5], [4, 2, 3]]) + x
    state = {"position": (7e6 + x, 0.0, 1e3), "velocity": (0.0, 7.5e3 + x, 1.0)}
    cube = {"normals": np.vstack([np.eye(axes), -np.eye(axes)]), "offsets": (1.0 + x,) * 2 * axes}
    no_elements = dict.fromkeys("semi_major_axis eccentricity inclination node perigee".split())
    no_elements |= dict.fromkeys("anomaly radius radial_speed angular_momentum latitude".split())
    date = f"{rng.integers(1, 9998):04}-02-28T23:59:59.{rng.integers(10**6):06}"
    stick = {"file": None, "times": np.array([0.0, x, 1 + x]), "velocities": np.full((3, 3), x)}
    paper = {"legacy": True, "unwrapped_angles": True, "avoidance_range": 1.5 + x}
    found: dict[str, dict[str, Any]] = {
        "Reconfiguration.max_control_axes": {"max_control": None, "max_control_axes": several},
        "Reconfiguration.max_speed_axes": {"max_speed": float("inf"), "max_speed_axes": several}
        | {"speed_norm": "inf"},
        "Reconfiguration.bargains": {"orders": 2, "bargains": int(rng.integers(1, 4))},
        "Reconfiguration.epsilon": {"epsilon": x},
        "Reconfiguration.solver": {"solver": "piqp", "fuel_norm": 1, "speed_norm": "inf"},
        "Reconfiguration.passive_safety_time": {"passive_safety": 60.0, "passive_safety_time": x},
        "Chief.position": no_elements | state,
        "Chief.velocity": no_elements | state,
        "Chief.epoch": {"epoch": date + str(pick(["", "Z", "+02:00", "-11:30"], rng))},
        "Chief.k_j2": {"j2": None, "k_j2": 1e25 * x},
        "Polytope.normals": {"points": None} | cube,
        "Leg.time_factor": {"steps": "auto", "time_factor": 1.2 + x},
        "Link.outage": {"outage": x, "outage_share": x},
        "Link.outage_share": {"outage": x, "outage_share": x},
        "EdgeList.pairs": {"pairs": np.array([[0, 1], [1, 2], [0, 2]])[: rng.integers(1, 4)]},
        "Connectivity.yaw": {"start": box, "yaw": rng.uniform(-3, 3, 6)},
        "Poses.positions": {"positions": box},
        "CollisionAvoidance.legacy": paper,
        "RecordedStick.times": stick,
        "RecordedStick.velocities": stick,
    }
    drags = {f"PlantSettings.{name}": drag | air for name in drag | air}
    return (found | drags).get(what, {})


class Spot(NamedTuple):
    """Field of a definition somewhere in a mission."""

    path: tuple[str | int, ...]  # attributes and indices that lead to its holder
    holder: type
    field: Field


def spots(value: Any, path: tuple[str | int, ...] = ()) -> Iterator[Spot]:
    """Yield the fields of a definition, and of those that it holds."""
    for field in fields_of(type(value)):
        yield Spot(path, type(value), field)
        held = getattr(value, field.name)
        here = (*path, field.name)
        if field.is_list:
            for k, part in enumerate(held):
                yield from spots(part, (*here, k))
        elif field.variants and is_definition(type(held)):
            yield from spots(held, here)


def get(value: Any, path: tuple[str | int, ...]) -> Any:
    """Return what a path leads to."""
    for part in path:
        value = value[part] if isinstance(part, int) else getattr(value, part)
    return value


def put(value: Any, path: tuple[str | int, ...], new: Any) -> Any:
    """Return a value with another part at the end of a path."""
    if not path:
        return new
    part, *rest = path
    if isinstance(part, int):
        return (*value[:part], put(value[part], tuple(rest), new), *value[part + 1 :])
    inner = put(getattr(value, part), tuple(rest), new)
    named = is_named_tuple(type(value))
    return value._replace(**{part: inner}) if named else replace(value, **{part: inner})


@cache
def targets() -> list[tuple[str, type, Field]]:
    """List every field of every definition of the three systems."""
    found: list[tuple[str, type, Field]] = []
    for system in ("reconfiguration", "formation", "connectivity"):
        classes: list[Any] = [type(bases()[system][0])]
        for kind in classes:
            for field in fields_of(kind):
                found.append((system, kind, field))
                classes += [part for part in field.variants if part not in classes]
    return found


@cache
def bases() -> dict[str, list[Mission]]:
    """Return the missions that are varied, by system: built-in ones and others."""
    found: dict[str, list[Mission]] = {}
    small = {"random": ["agents=9"], "uiuc": ["agents=30"], "orbit": ["agents=6"]}
    small |= {"orbit200": ["agents=6"], "formation100": ["agents=10"], "random3d": ["agents=8"]}
    for name in sato.scenarios():
        mission = sato.read(name, small.get(name, ()))
        found.setdefault(mission.system, []).append(mission)
    venus = sato.Orbit.from_elements(1e7, inclination=0.8, mu=3.24859e14)
    place = np.array([[0.0, 0, 0], [0, 200, 0], [0, 400, 0]])
    rest: dict[str, Any] = {"comm_radius": 4e3, "collision_radius": 50.0, "max_control": 0.01}
    rest |= {"max_speed": 4.0}
    up, far = np.array([0.0, 30, 0]), np.array([0.0, 900, 0])
    wanted = np.concatenate([place + up, place + far])
    legs = [sato.Leg(wanted, steps=20, joins=[sato.Join(start=place + far)])]
    found["reconfiguration"] += [
        sato.Reconfiguration(start=place, legs=legs, step=60.0, chief=orbit, model=model, **rest)
        for orbit, model in (
            (venus, sato.J2(venus)),
            (replace(venus, body_radius=1e6), sato.TschaunerHempel(venus)),
            (None, sato.ClohessyWiltshire(1e-3)),
        )
    ]
    poses = np.array([[3.0 * k, 3.0 * (k % 2), 3.0] for k in range(6)])
    found["connectivity"] += [sato.Connectivity(start=poses, yaw=np.zeros(6))]
    return found


def draw_value(field: Field, now: Any, axes: int, rng: Generator) -> Any:
    """Draw a value for a field, near the one that it has or by its annotation."""
    if field.variants:
        return draw_variants(field, now, axes, rng)
    return draw_plain(field.hint, now, axes, rng)


def draw_variants(field: Field, now: Any, axes: int, rng: Generator) -> Any:
    """Draw a definition, or a list of some, that a field may hold."""
    if field.is_list:
        count = int(rng.integers(1, 3))
        return tuple(draw_definition(pick(field.variants, rng), axes, rng) for _ in range(count))
    kinds: list[Any] = [*field.variants]
    if type(None) in field.others:
        kinds.append(None)
    kind = pick(kinds, rng)
    return None if kind is None else draw_definition(kind, axes, rng)


def draw_definition(kind: Any, axes: int, rng: Generator) -> Any:
    """Draw a definition of a class: required fields, and some others.

    Raises:
        InputError: No draw makes one.
    """
    for k in range(TRIES):
        values: dict[str, Any] = {}
        for field in fields_of(kind):
            together = draw_together(f"{kind.__name__}.{field.name}", axes, rng)
            if together and field.default is MISSING:
                values |= together
            elif field.name == "file":
                values["file"] = FILES.get(kind.__name__)
            elif field.default is MISSING or rng.random() < 0.3:
                now = None if field.default is MISSING else field.default
                values[field.name] = draw_value(field, now, axes, rng)
        try:
            return kind(**{name: v for name, v in values.items() if v is not None})
        except (sato.InputError, TypeError):
            if k == TRIES - 1:
                raise
    raise AssertionError


def draw_plain(hint: Any, now: Any, axes: int, rng: Generator) -> Any:
    """Draw a number, text, list or array by an annotation."""
    if get_origin(hint) is Annotated:
        return draw_plain(get_args(hint)[0], now, axes, rng)
    if get_origin(hint) is Literal:
        return pick(get_args(hint), rng)
    options = get_args(hint)
    if options and get_origin(hint) is not tuple and hint is not np.ndarray:
        chosen = pick([part for part in options if part is not type(None)] or [options[0]], rng)
        return (
            None
            if type(None) in options and rng.random() < 0.1
            else draw_plain(chosen, now, axes, rng)
        )
    if get_origin(hint) is tuple:
        if isinstance(now, tuple) and now:
            return tuple(near(part, rng) for part in now)
        whole = int in get_args(hint) or "int" in str(hint)
        count = int(rng.choice([axes, axes, 2, 3, 1]))
        return tuple(int(rng.integers(0, 5)) if whole else near(1.0, rng) for _ in range(count))
    if hint is np.ndarray:
        if isinstance(now, np.ndarray):
            return near(now, rng) if now.dtype.kind == "f" else now[::-1]
        shape = pick([(3, axes), (4, 3), (3,), (6, 6), (2, axes), (6, 5)], rng)
        return rng.normal(scale=5.0, size=shape)
    if hint is bool:
        return bool(rng.integers(2))
    if hint is int:
        return int(rng.integers(0, 8)) if now is None else max(0, now + int(rng.integers(-3, 4)))
    if hint is float:
        return near(1.0 if now is None else now, rng)
    return pick(TEXTS, rng)


def near(value: Any, rng: Generator) -> Any:
    """Draw a number or an array near another, or now and then any number."""
    if isinstance(value, np.ndarray):
        return value * rng.uniform(0.9, 1.1)
    if isinstance(value, bool | str) or value is None:
        return value
    if isinstance(value, int):
        return max(0, value + int(rng.integers(-1, 2)))
    if rng.random() < 0.3:
        return pick(NUMBERS, rng)
    return float(value) * rng.uniform(0.8, 1.25) if value else float(rng.uniform(0, 1))


def pick(values: Any, rng: Generator) -> Any:
    """Choose one of some values."""
    return values[int(rng.integers(len(values)))]


def own_kind(kind: type) -> type:
    """Return a class of the user's own, as one of the library but for its name."""
    name = f"Own{kind.__name__}"
    if name not in globals():
        globals()[name] = type(name, (kind,), {"__module__": __name__, "__qualname__": name})
    found: type = globals()[name]
    return found


def make_own(mission: Mission, rng: Generator) -> Mission:
    """Return a mission in which a value is of the user's own."""
    held = [(s, v) for s in spots(mission) if s.field.variants for v in [get(mission, s.path)]]
    choices = [(s, getattr(v, s.field.name)) for s, v in held]
    spot, value = pick([(s, v) for s, v in choices if v not in (None, ())], rng)
    path = (*spot.path, spot.field.name)
    if spot.field.is_list:
        k = int(rng.integers(len(value)))
        path, value = (*path, k), value[k]
    if spot.field.name == "plant" and Plant in spot.field.others and rng.random() < 0.5:
        return put(mission, path, Euler(rng.random()))
    if spot.field.name == "model" and rng.random() < 0.7:
        return put(mission, path, Damped(rng.random()))
    if not is_definition(type(value)):
        return mission
    parts = {f.name: getattr(value, f.name) for f in fields_of(type(value))}
    return put(mission, path, own_kind(type(value))(**parts))


def count_own(value: Any) -> Iterator[str]:
    """Yield the names of classes of the user's own in a mission."""
    for spot in spots(value):
        held = getattr(get(value, spot.path), spot.field.name)
        for part in held if spot.field.is_list else (held,):
            if spot.field.variants and part is not None and type(part) not in spot.field.variants:
                yield type(part).__qualname__


def differences(one: Any, other: Any, at: str = "") -> Iterator[str]:
    """Yield the places where two values differ, floats by their bits but for the sign of zero."""
    if type(one) is not type(other):
        yield f"{at}: {type(one).__name__} became {type(other).__name__}"
    elif is_definition(type(one)):
        for field in fields_of(type(one)):
            pair = getattr(one, field.name), getattr(other, field.name)
            yield from differences(*pair, f"{at}.{field.name}")
    elif isinstance(one, np.ndarray):
        if one.shape != other.shape or one.tobytes() != other.tobytes():
            yield f"{at}: {one} became {other}"
        if one.flags.writeable != other.flags.writeable:
            yield f"{at}: an array that can be written to"
    elif isinstance(one, tuple):
        for k, pair in enumerate(zip(one, other, strict=False)):
            yield from differences(*pair, f"{at}.{k}")
        if len(one) != len(other):
            yield f"{at}: {len(one)} became {len(other)}"
    elif isinstance(one, Model | Plant):
        parts = [f.name for f in fields(one)] if is_dataclass(one) else list(vars(one))
        for name in parts:
            yield from differences(getattr(one, name), getattr(other, name), f"{at}.{name}")
    elif not (one == other or one is other):
        yield f"{at}: {one!r} became {other!r}"


def compare(name: str, mission: Any, again: Any) -> Iterator[str]:
    """Yield what is wrong with a mission that should be the same."""
    found = list(differences(mission, again))
    if found or again != mission or hash(again) != hash(mission):
        equal = "equal" if again == mission else "not equal"
        yield f"{name}: {equal}, {'; '.join(found) or 'of another hash'}"


def check(mission: Mission) -> Iterator[str]:
    """Yield what is wrong with the round trips of a mission."""
    copies = pickle.loads(pickle.dumps(mission)), copy.deepcopy(mission), replace(mission)
    for name, again in zip(("pickle", "deepcopy", "replace"), copies, strict=True):
        yield from compare(name, mission, again)
    text, own = mission.to_toml(), list(count_own(mission.without_files()))
    named = [kind.rpartition(".")[2] for _, kind in find_own(tomllib.loads(text))]
    if sorted(named) != sorted(own):
        yield f"to_toml: names {named}, and there are {own}"
    try:
        again = sato.parse(text)
    except sato.ScenarioError as error:
        if not own or not any(kind in str(error) for kind in own):
            yield f"to_toml: is not read again: {error}"
        if not all(kind in describe_own(text) for kind in own):
            yield f"describe_own: {describe_own(text)}, and there are {own}"
        return
    if own:
        yield f"to_toml: {own} is read as something else"
    yield from compare("to_toml", mission.without_files(), again)
    if again.to_toml() != text:
        yield "to_toml: another text"


def check_flight(mission: Any, folder: Path) -> Iterator[str]:
    """Yield what is wrong with a run of a mission that is saved and loaded."""
    if isinstance(mission, sato.Connectivity):
        mission = replace(mission, duration=0.2, losses=())
    try:
        run = sato.run(mission)
    except ValueError:
        return
    run.save(folder)
    own, loaded = list(count_own(mission.without_files())), sato.load(folder)
    report = loaded.check()
    if own:
        given = sato.load(folder, mission=mission).check()
        if loaded.mission is not None or not all(kind in str(report) for kind in own):
            yield f"load: {own} are not named in {report}"
        names = {promise.name for promise in (*report.promises, *given.promises)}
        if set(report.skipped) != names - {promise.name for promise in report.promises}:
            yield f"load: skipped {report.skipped}"
        report = given
    else:
        yield from compare("load", mission.without_files(), loaded.mission)
    if [p.name for p in report.broken] != [p.name for p in run.check().broken]:
        yield f"load: {report}"
    yield from compare("pickle of a drawn mission", run.drawn_mission, _pickled(run.drawn_mission))


def _pickled(value: Any) -> Any:
    return pickle.loads(pickle.dumps(value))


def vary(number: int, rng: Generator) -> tuple[Mission | None, str]:
    """Return a mission in which a field, by the number, is another, and what that is."""
    system, kind, field = targets()[number % len(targets())]
    what = f"{kind.__name__}.{field.name}"
    for _ in range(TRIES):
        mission: Any = pick(bases()[system], rng)
        axes = getattr(mission, "axes", 3)
        try:
            mission = insert(mission, kind, axes, rng)
            held = [spot for spot in spots(mission) if spot.holder is kind]
            spot = pick([spot for spot in held if spot.field.name == field.name], rng)
            path = (*spot.path, field.name)
            together = draw_together(what, axes, rng)
            if together:
                holder = get(mission, spot.path)
                named = is_named_tuple(type(holder))
                new = holder._replace(**together) if named else replace(holder, **together)
                changed = put(mission, spot.path, new)
            else:
                changed = put(mission, path, draw_value(field, get(mission, path), axes, rng))
        except (sato.InputError, LookupError, TypeError):
            continue
        if changed != mission:
            return changed, what
    return None, what


def insert(mission: Any, kind: type, axes: int, rng: Generator) -> Any:
    """Return a mission that holds a definition of a class; LookupError without a place."""
    if any(spot.holder is kind for spot in spots(mission)):
        return mission
    places = [spot for spot in spots(mission) if kind in spot.field.variants]
    if not places:  # its holders are to be inserted first
        holders = [c for _, c, f in targets() if kind in f.variants and c is not type(mission)]
        mission = insert(mission, pick(holders, rng), axes, rng)
        places = [spot for spot in spots(mission) if kind in spot.field.variants]
    spot = pick(places, rng)
    new = draw_definition(kind, axes, rng)
    return put(mission, (*spot.path, spot.field.name), (new,) if spot.field.is_list else new)


def write_files(folder: Path) -> None:
    """Write the files that definitions may name."""
    points = "\n".join(f"{4 * k},{k % 2},1" for k in range(40))
    for kind, text in (
        ("Points", points),
        ("FormationFile", "\n".join(points.split("\n")[:6])),
        ("GraphFile", "\n".join(f"{i},{j}" for i in range(6) for j in range(i))),
        ("RecordedStick", "0,0.1,0,0\n1,0,0.2,0"),
    ):
        path = folder / f"{kind}.csv"
        path.write_text(text, encoding="utf-8")
        FILES[kind] = str(path)
    corners = np.array([[4.0 * k, 3.0 * (k % 2), 1.0] for k in range(6)])
    gains = sato.design_gains(DesiredFormation(corners, ~np.eye(6, dtype=bool)))
    FILES["GainsFile"] = str(folder / "gains.npz")
    gains.save(FILES["GainsFile"])
    import matplotlib.image

    FILES["Picture"] = str(folder / "picture.png")
    dark = np.ones((40, 40))
    dark[5:35, 10:30] = 0
    matplotlib.image.imsave(FILES["Picture"], dark, cmap="gray", vmin=0, vmax=1)


def fuzz(count: int, seed: int, flights: bool) -> tuple[list[str], Counter[str], set[str]]:
    """Send missions through files and copies.

    Returns:
        What is wrong; how many were equal, refused, or named as skipped; and the fields that were
        varied and kept.
    """
    wrong: list[str] = []
    ends: Counter[str] = Counter()
    kept: set[str] = set()
    with tempfile.TemporaryDirectory() as name, warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        folder = Path(name)
        write_files(folder)
        for k in range(count):
            rng = np.random.default_rng([seed, k])
            mission, what = vary(k, rng)
            if mission is None:
                ends["refused"] += 1
                continue
            kept.add(what)
            try:
                if rng.random() < OWN_SHARE:
                    mission = make_own(mission, rng)
                found = list(check(mission))
                if flights and k % 50 == 0:
                    found += check_flight(mission, folder / "run")
            except sato.InputError:
                ends["refused"] += 1
                continue
            except Exception as error:
                found = [f"{type(error).__name__}: {error}"]
            wrong += [f"{k} {what}: {text}" for text in found]
            ends["wrong" if found else "skipped" if any(count_own(mission)) else "equal"] += 1
    return wrong, ends, kept


def main() -> int:
    """Print what is wrong, and the fields that were never kept."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--flights", action="store_true", help="fly, save and load every 50th")
    given = parser.parse_args()
    wrong, ends, kept = fuzz(given.count, given.seed, given.flights)
    print("\n".join(wrong))
    names = {f"{kind.__name__}.{field.name}" for _, kind, field in targets()}
    lacking = sorted(names - kept - MOVED) if given.count >= len(targets()) else []
    print(f"{dict(ends)}; {len(kept)} of {len(names)} fields varied; not: {', '.join(lacking)}")
    return 1 if wrong or lacking else 0


if __name__ == "__main__":
    sys.exit(main())
