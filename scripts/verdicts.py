"""Fly collisions and forge runs, and ask every place for the verdict: python scripts/verdicts.py.

Of 100 runs, 20 collide by the methods as printed, 15 by a plant that departs beyond the margin, 15
in a file that got a larger radius or an ellipsoid after the flight, and 50 are forged, of all three
systems: states, commands, targets or summaries, sealed anew or not. Collisions are those that a
measurement of the script's own finds, by straight lines or cubics between the recorded instants.

Each run is asked for by its folder: `success` in the summary that Python gives, the first lines of
`repr`, HTML, player, `sato check` and, where it was flown here, `sato run`, exit codes, and the
columns of a campaign. Of a collision, the line must name the pair, the time and the distance that
were measured. As many honest runs must be kept everywhere. Exit code 1 where a place is wrong.
"""

import argparse
import json
import sys
import tempfile
import tomllib
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from html import escape
from itertools import count, cycle, islice
from math import ceil
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tomli_w
from numpy.random import Generator
from scipy.interpolate import CubicHermiteSpline
from typer.testing import CliRunner

import sato
from sato.campaigns.definition import Campaign
from sato.campaigns.table import CampaignTable
from sato.campaigns.trial import judge
from sato.cli import app
from sato.record import RunFileError
from sato.runs import Run

FINE = 0.002  # between two measurements of distances [s]
CLOSE = 0.995  # of the distance that is kept, below which it counts as a collision
ALIKE = 2e-3  # difference of a distance from the one that is measured, relative and [m]
PLACES = ("python", "summary", "repr", "html", "player", "check", "exit code", "campaign", "run")
Words = list[str]
Forge = Callable[[Run, Generator], Run]


class Case(NamedTuple):
    """Run in a folder, with what was measured of it."""

    name: str
    folder: Path
    verdict: str  # that every place must give
    contact: "Contact | None" = None  # that its line must name
    flown: Any = None  # result of `sato run`


class Contact(NamedTuple):
    """Closest approach by a measurement of the script's own."""

    ratio: float  # of the distance to that which is kept
    distance: float  # [m]
    pair: tuple[int, int]
    time: float  # [s]


def measure(data: Any, kept: float, axes: list[float] | None = None) -> Contact:
    """Measure the closest approach of a run, in ellipsoids with these axes."""
    time, p = data["time"].values, data["position"].values
    if data.attrs["system"] == "formation":
        p = p[..., :2]
    scaled = p / np.array(axes if axes else [1.0] * p.shape[2])
    fine = np.linspace(time[0], time[-1], round((time[-1] - time[0]) / FINE) + 1)
    if data.attrs["system"] == "reconfiguration":
        v = data["velocity"].values / np.array(axes if axes else [1.0] * p.shape[2])
        path = CubicHermiteSpline(time, scaled, v)(fine)
    else:
        path = np.stack([np.interp(fine, time, x) for x in scaled.reshape(len(time), -1).T], axis=1)
    path = path.reshape(len(fine), *p.shape[1:])
    i, j = np.triu_indices(p.shape[1], 1)
    apart = np.linalg.norm(path[:, i] - path[:, j], axis=2)
    k, pair = np.unravel_index(int(apart.argmin()), apart.shape)
    least = float(apart[k, pair])
    return Contact(least / kept, least, (int(i[pair]), int(j[pair])), float(fine[k]))


def kept_distance(data: Any) -> float:
    """Return the distance that vehicles of a run keep, by its scenario."""
    scenario = tomllib.loads(data.attrs["scenario"])
    match data.attrs["system"]:
        case "reconfiguration":
            return float(scenario["swarm"]["collision_radius_m"])
        case "formation":
            noise = scenario.get("frames", {}).get("noise_m", 0.02)
            return float(scenario["swarm"].get("keep_out_m", 1.2)) - min(2.5 * noise, 0.05)
    return float(scenario["repulsion"]["nearest_m"])


def fly(scenario: str | dict[str, Any], seed: int, words: Words, folder: Path) -> Any:
    """Fly a scenario by the command line; return its result, None where it is refused."""
    source = scenario
    if isinstance(scenario, dict):
        source = str(folder.with_suffix(".toml"))
        Path(source).write_text(tomli_w.dumps(scenario), encoding="utf-8")
    overrides = [part for word in words for part in ("--set", word)]
    call = ["run", str(source), "--seed", str(seed), "--out", str(folder), *overrides]
    result = CliRunner().invoke(app, call)
    return None if result.exit_code == 2 else result


def swap(rng: Generator, vehicles: int = 5) -> dict[str, Any]:
    """Draw a mission in which vehicles on a ring exchange places through its center."""
    angle = 2 * np.pi * (np.arange(vehicles) + rng.random()) / vehicles
    start = 5 * np.c_[np.cos(angle), np.sin(angle)]
    goal = rng.uniform(-0.3, 0.3, start.shape) - start
    shape = {"kind": "points", "positions_m": goal.tolist(), "keep_order": True}
    swarm = {"start": {"kind": "points", "positions_m": start.tolist()}, "comm_radius_m": 15.0}
    limits = {"max_control_m_s2": 0.3, "max_speed_m_s": 1.0}
    noise = {"acceleration_m_s2": 0.1, "position_m": 0.1, "velocity_m_s": 0.1}
    return {
        "system": "reconfiguration",
        "name": "swap",
        "swarm": swarm | {"collision_radius_m": 0.7},
        "model": {"kind": "double_integrator", **limits},
        "plan": {"step_s": 1.0, "margin_m": 0.0, "assignment": "given"},
        "disturbance": noise,
        "leg": [{"shape": shape, "steps": 25}],
    }


def draw_printed(rng: Generator) -> Iterator[tuple[Any, Words]]:
    """Draw missions flown by the methods as printed: letters in a crowd, and formations."""
    crowd = ["agents=14", 'start={kind="random", separation_m=0.6, box_m=6.0}']
    crowd.append('leg=[{shape={kind="lattice", spacing_m=1.0}, targets=14, steps=30}]')
    legacy = ["legacy_avoidance=true", "assignment.kind=none", "limit_s=20"]
    yield from cycle([("uiuc_printed", crowd), ("uiuc_printed", crowd), ("formation6", legacy)])


def draw_departing(rng: Generator) -> Iterator[tuple[Any, Words]]:
    """Draw missions whose plants depart from the model by more than the margin."""
    start = 'start={kind="random", separation_m=1.05, lambda2=0.05}'
    while True:
        yield swap(rng), []
        plant = f'plant={{kind="kinematic", noise={rng.uniform(4, 9):.2f}}}'
        yield "connectivity", [plant, "duration_s=4", "strength=0.01", "agents=8", start]


HONEST: dict[str, list[tuple[str, Words]]] = {
    "reconfiguration": [("crossing", []), ("random", ["agents=6"]), ("random3d", ["agents=6"])],
    "formation": [("formation6", [])],
    "connectivity": [("connectivity", ["duration_s=4", "agents=5"])],
}


@cache
def fly_honest(system: str, number: int, home: Path) -> Run:
    """Fly an honest run, and load it from its folder."""
    for seed in count(number):
        scenario, words = HONEST[system][number % len(HONEST[system])]
        folder = home / f"honest-{system}-{number}-{seed}"
        result = fly(scenario, seed, words, folder)
        if result is not None and result.exit_code == 0:
            return sato.load(folder)
    raise AssertionError("unreachable")


def widen(run: Run, rng: Generator, seals: bool) -> tuple[Run, Contact] | None:
    """Give the file of a run a larger radius, or an ellipsoid; None where there is no room."""
    scenario, attrs = tomllib.loads(run.data.attrs["scenario"]), dict(run.recorded.attrs)
    system, axes = run.summary["system"], None
    near = measure(run.data, 1.0)
    first = run.data["position"].values[0]
    i, j = np.triu_indices(len(first), 1)
    free = float(np.linalg.norm(first[i] - first[j], axis=1).min())
    larger = near.distance + rng.uniform(0.1, 0.5) * min(free - near.distance, 0.4)
    if system == "formation":
        larger = min(larger, 1.4)  # the start of its scenario is drawn with 1.5
    if larger < near.distance / CLOSE:
        return None
    if system == "reconfiguration" and first.shape[1] == 3:
        kept, axes = kept_distance(run.data), [1.0, 1.0, float(rng.uniform(1.5, 2.5))]
        scenario["model"]["separation_axes"] = axes
        larger = kept
    elif system == "reconfiguration":
        scenario["swarm"]["collision_radius_m"] = attrs["collision_radius_m"] = larger
    elif system == "formation":
        noise = kept_distance(run.data)
        scenario["swarm"]["keep_out_m"] = larger + scenario["swarm"].get("keep_out_m", 1.2) - noise
    else:
        scenario["repulsion"]["nearest_m"] = larger
    attrs["scenario"] = tomli_w.dumps(scenario)
    contact = measure(run.data, larger, axes)
    if contact.ratio > CLOSE:
        return None
    data = replace(run.recorded, attrs=attrs)
    return replace(run, recorded=data.seal() if seals else data), contact


def shift(names: dict[str, str]) -> Forge:
    """Return a forgery that shifts one number of a variable, by the system."""

    def forge(run: Run, rng: Generator) -> Run:
        variables = dict(run.recorded.variables)
        size = rng.choice([-1, 1]) * 10.0 ** rng.uniform(-5, -1)
        for name in names[run.recorded.attrs["system"]].split():
            values = np.array(variables[name].values)
            places = np.argwhere(np.isfinite(values))
            if name == names[run.recorded.attrs["system"]].split()[0]:
                where = tuple(places[rng.integers(len(places))])
            values[where] = values[where] + (size if values.dtype.kind == "f" else 1)
            variables[name] = variables[name]._replace(values=values)
        return replace(run, recorded=replace(run.recorded, variables=variables))

    return forge


def claim(**entries: Any) -> Forge:
    """Return a forgery of entries of the summary."""
    return lambda run, rng: replace(run, claimed={**run.claimed, **entries})


def cut(run: Run, rng: Generator) -> Run:
    """Return a flight that was stopped, with the summary of the whole one."""
    last = int(len(run.data["time"]) * rng.uniform(0.3, 0.8))
    data = run.data.isel(time=slice(last)).copy(deep=True)
    until = float(data["time"].values[-1])
    data = data.isel(event=[json.loads(str(e))["time"] <= until for e in data["event"].values])
    for name, var in data.data_vars.items():
        if name in ("control", "applied_control"):
            var[-1] = np.nan
    data.attrs |= {"complete": 0, "stopped": "interrupted"}
    return replace(run, recorded=type(run.recorded).from_xarray(data))


FORGERIES: dict[str, Forge] = {
    "states": shift(dict.fromkeys(HONEST, "position")),
    "commands": shift(
        {
            "reconfiguration": "control applied_control",
            "formation": "velocity",
            "connectivity": "velocity_command",
        }
    ),
    "targets": shift(
        {
            "reconfiguration": "target_position",
            "formation": "point_index",
            "connectivity": "stick",
        }
    ),
    "a flight cut short": cut,
    "a summary": claim(min_separation_m=99.0),
    "a verdict of the summary": claim(verdict="not reached", success=True),
}


def save(run: Run, folder: Path) -> Path:
    """Save a run with the summary that it claims, as a forger would."""
    folder.mkdir()
    (folder / "run.nc").write_bytes(run.recorded.to_netcdf())
    text = json.dumps(dict(run.claimed) | {"success": True})
    (folder / "summary.json").write_text(text, encoding="utf-8")
    return folder


def collect_flown(
    name: str, source: Iterator[tuple[Any, Words]], number: int, home: Path
) -> Iterator[Case]:
    """Fly missions until so many collided by the script's own measurement."""
    found = 0
    for seed, (scenario, words) in enumerate(source):
        folder = home / f"{name}-{seed}".replace(" ", "-")
        result = fly(scenario, seed, words, folder)
        if found == number:
            return
        if result is None:
            continue
        data = sato.load(folder).data
        contact = measure(data, kept_distance(data))
        if contact.ratio < CLOSE:
            found += 1
            yield Case(name, folder, "broken", contact, result)


def collect_cases(number: int, seed: int, home: Path) -> Iterator[Case]:
    """Yield all cases: collisions, forged runs, and honest ones."""
    rng = np.random.default_rng(seed)
    shares = ceil(0.4 * number), ceil(0.3 * number)
    yield from collect_flown("as printed", draw_printed(rng), shares[0], home)
    yield from collect_flown("beyond margin", draw_departing(rng), shares[1], home)
    systems = (each for each in enumerate(cycle(HONEST)))
    widened = (widen(fly_honest(s, k // 3, home), rng, k % 2 == 0) for k, s in systems)
    for k, (run, contact) in enumerate(islice(filter(None, widened), shares[1])):
        folder = save(run, home / f"widened-{k}")
        yield Case("larger after flight", folder, "broken", contact)
    for k in range(number):
        name = list(FORGERIES)[k // 3 % len(FORGERIES)]
        forged = FORGERIES[name](fly_honest(list(HONEST)[k % 3], k % 4, home), rng)
        if k // 3 // len(FORGERIES) % 2 == 0:
            forged = replace(forged, recorded=forged.recorded.seal())
        yield Case("forged", save(forged, home / f"forged-{k}"), "broken")
    for k in range(max(number // 5, 3)):
        folder = save(fly_honest(list(HONEST)[k % 3], k % 4, home), home / f"kept-{k}")
        yield Case("honest", folder, "kept")


def names_contact(line: str, contact: Contact) -> bool:
    """Tell whether a line names the pair, the time and the distance that were measured."""
    first = line.split("; also")[0]
    agents = f"agents {contact.pair[0]} and {contact.pair[1]} at "
    if not first.startswith("BROKEN: separation, ") or agents not in first:
        return False
    value, time = float(first.split()[2]), float(first.rsplit(" at ", 1)[1].split()[0])
    wanted = contact.ratio if "ellipsoid" in first else contact.distance
    return bool(
        np.isclose(value, wanted, rtol=ALIKE, atol=ALIKE) and abs(time - contact.time) < 0.1
    )


def ask(case: Case, table: CampaignTable, row: int) -> dict[str, bool]:
    """Ask every place about a case; True where its answer is right."""
    is_kept, word = case.verdict == "kept", case.verdict.upper() + ":"
    try:
        run = sato.load(case.folder)
    except RunFileError:  # nothing is shown, and nothing is claimed
        result = CliRunner().invoke(app, ["check", str(case.folder)])
        return dict.fromkeys(PLACES[:-1], not is_kept and result.exit_code == 2)
    line = run.report.line
    try:
        page = run.player(case.folder / "player.html").read_text("utf-8")
    except RunFileError:  # of a damaged record, of which nothing can be shown
        page = "" if is_kept else f'<p id="verdict">{escape(line)}</p>'
    told = CliRunner().invoke(app, ["check", str(case.folder)])
    table.add(table.campaign.trial(row, str(table.folder)), judge(run), 1)
    cells = table.row(row)
    is_right = line.startswith(word)
    if case.contact is not None:
        is_right = is_right and names_contact(line, case.contact)
    found = {
        "python": run.verdict == case.verdict and run.check().kept is is_kept,
        "summary": run.summary["success"] is is_kept and run.summary["verdict"] == case.verdict,
        "repr": is_right and repr(run).splitlines()[0] == line == str(run.check()).splitlines()[0],
        "html": run._repr_html_().startswith(f"<pre>{escape(line)}\n"),
        "player": f'<p id="verdict">{escape(line)}</p>' in page,
        "check": told.stdout.splitlines()[0] == line,
        "exit code": told.exit_code == (0 if is_kept else 1),
        "campaign": (cells["verdict"], cells["success"]) == (case.verdict, int(is_kept))
        and (cells["error"] or line) == line,
    }
    if case.flown is not None:
        said = [text for text in case.flown.stdout.splitlines() if text.strip()]
        found["run"] = said[0] == line and case.flown.exit_code == 1
    return found


def main() -> int:
    """Fly, forge and ask; print a table of right answers."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--count", type=int, default=50, help="collisions, and forged runs")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    right, asked = Counter[tuple[str, str]](), Counter[tuple[str, str]]()
    with tempfile.TemporaryDirectory() as text:
        home, wrong = Path(text), list[str]()
        (home / "table").mkdir()
        campaign = Campaign(name="table", scenario="crossing", trials=4 * options.count + 9)
        with CampaignTable.create(home / "table", campaign) as table:
            for row, case in enumerate(collect_cases(options.count, options.seed, home)):
                for place, is_right in ask(case, table, row).items():
                    asked[case.name, place] += 1
                    right[case.name, place] += is_right
                    if not is_right:
                        line = sato.load(case.folder).report.line
                        wrong.append(f"{case.folder.name}, {place}: {line}, {case.contact}")
    names = list(dict.fromkeys(name for name, _ in asked))
    print(f"{'runs':20}", *(f"{place:>9}" for place in PLACES))
    for name in names:
        cells = [f"{right[name, p]}/{asked[name, p]}" if asked[name, p] else "–" for p in PLACES]
        print(f"{name:20}", *(f"{cell:>9}" for cell in cells))
    print(*wrong, sep="\n")
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
