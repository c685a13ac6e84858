"""Record a set of flights, and compare later flights with the record bit for bit.

    python scripts/safety_net.py record DIR
    python scripts/safety_net.py compare DIR

A flight is recorded as its variables, its events and its summary. Entries that have been
renamed since the record was made are compared under their new names.
"""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

import sato

FLIGHTS: dict[str, tuple[str, ...]] = {
    "crossing": (),
    "conflict": (),
    "undetectable": (),
    "random": ("agents=20",),
    "random3d": (),
    "random_cw": (),
    "orbit": (),
    "eccentric": (),
    "uiuc": (),
    "formation": (),
    "formation6": (),
    "connectivity-exact": ("estimator.kind=exact",),
    "connectivity-flood": ("estimator.kind=flood",),
    "connectivity-power_pi": ("estimator.kind=power_pi",),
}
UNREPEATABLE = ("wall_s", "peak_memory_mib", "version")  # entries of the summary
RENAMED: dict[str, dict[str, str]] = {  # old: new
    "variables": {
        "leg": "leg_index",
        "target": "target_index",
        "believed": "target_count",
        "point": "point_index",
    },
    "events": {
        "no flight keeps clear of those that go before": (
            "no trajectory keeps clear of agents with priority"
        ),
    },
    "summary": {},
}


def main() -> int:
    """Record or compare the flights; return the number of flights that differ."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("action", choices=("record", "compare"))
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", nargs="*", default=list(FLIGHTS), help="names of flights")
    asked = parser.parse_args()
    different = 0
    for name in asked.only:
        run = sato.run(name.partition("-")[0], seed=0, overrides=FLIGHTS[name])
        if asked.action == "record":
            _record(asked.folder, name, run)
            print(f"{name}: recorded", flush=True)
        else:
            faults = _differences(asked.folder, name, run)
            different += bool(faults)
            print(f"{name}: {'; '.join(faults) or 'equal'}", flush=True)
    return different


def _record(folder: Path, name: str, run: sato.Run) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(folder / f"{name}.npz", **_variables(run))
    text = json.dumps(_words(run), indent=1)
    (folder / f"{name}.json").write_text(text, encoding="utf-8")


def _differences(folder: Path, name: str, run: sato.Run) -> list[str]:
    was = dict(np.load(folder / f"{name}.npz"))
    variables, faults = _variables(run), []
    for old, values in was.items():
        new = RENAMED["variables"].get(old, old)
        if new not in variables:
            faults.append(f"no variable {new}")
        elif not np.array_equal(values, variables[new], equal_nan=True):
            faults.append(f"{new} {_distance(values, variables[new])}")
    recorded = json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))
    for part, now in _words(run).items():
        before = _renamed(recorded[part], RENAMED[part])
        if part == "summary":
            before = {key: before[key] for key in before if key not in UNREPEATABLE}
            now = {key: now.get(key) for key in before}
        if before != now:
            faults.append(f"{part} differ{_first_difference(before, now)}")
    return faults


def _variables(run: sato.Run) -> dict[str, np.ndarray]:
    return {
        str(name): values.values
        for name, values in run.data.variables.items()
        if values.dtype.kind in "biuf"
    }


def _words(run: sato.Run) -> dict[str, Any]:
    words = {"events": run.events(), "summary": run.summary}
    return json.loads(json.dumps(words, default=lambda value: value.tolist()))  # type: ignore[no-any-return]


def _renamed(value: Any, names: dict[str, str]) -> Any:
    if isinstance(value, dict):
        return {names.get(key, key): _renamed(part, names) for key, part in value.items()}
    if isinstance(value, list):
        return [_renamed(part, names) for part in value]
    return names.get(value, value) if isinstance(value, str) else value


def _first_difference(before: Any, now: Any) -> str:
    if isinstance(before, dict) and isinstance(now, dict):
        keys = [key for key in {**before, **now} if before.get(key) != now.get(key)]
        first = keys[0]
        return f" at {first}{_first_difference(before.get(first), now.get(first))}"
    if isinstance(before, list) and isinstance(now, list) and len(before) == len(now):
        i = next(i for i, pair in enumerate(zip(before, now, strict=True)) if pair[0] != pair[1])
        return f" at {i}{_first_difference(before[i], now[i])}"
    return f": {str(before)[:60]} became {str(now)[:60]}"


def _distance(before: np.ndarray, now: np.ndarray) -> str:
    if before.shape != now.shape:
        return f"has shape {now.shape}, not {before.shape}"
    off = np.abs(before.astype(float) - now.astype(float))
    return f"differs by {np.nanmax(off):.3g} at most"


if __name__ == "__main__":
    sys.exit(main())
