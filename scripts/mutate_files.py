"""Damage run files, campaigns and scenarios at random, and use them as a stranger's.

Each is read by commands, which must end within a time, with a sentence or a verdict: no traceback,
no "fault of the program", no command of a terminal. Exit 1 where one does not.

    python scripts/mutate_files.py --count 3000 --seed 1
"""

import json
import shutil
import signal
import sqlite3
import sys
import tempfile
import warnings
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from time import process_time
from typing import Annotated, Any

import h5py
import numpy as np
import typer
from click.testing import CliRunner

import sato
from sato.cli import app

LONGEST = 10.0  # of a command [s], of the processor
HANGS = 120  # after which a command is given up [s]
SLOW, SHARE = ("plot", "report"), 0.1  # commands that take seconds, and the share of files they get
FAULT = "fault of the program"
ODD: list[Any] = [
    "", "x", "[/red]", "\x1b[2J", "<script>", "../../etc/passwd", "nan", "9" * 400, "[[leg]]", "{}",
    0, -1, 1, 2**40, -(2**63), 1e308, -1e-308, float("nan"), float("inf"), True, [], [1, 2], ["a"],
]  # fmt: skip
SCENARIOS = {
    "crossing": (), "conflict": (), "formation": (), "random_cw": ("swarm.agents=4",),
    "connectivity": ("run.duration_s=2", "swarm.agents=3"),
}  # fmt: skip
READS = (
    ("check",), ("check", "--json"), ("player", "-o", "{out}/p.html"), ("plot", "--out", "{out}"),
    ("export", "--format", "csv", "--out", "{out}/c.csv"), ("export", "--out", "{out}/o"),
)  # fmt: skip
CAMPAIGN_READS = (
    ("campaign", "status"), ("campaign", "table"), ("campaign", "table", "--rows"),
    ("campaign", "export", "--out", "{out}/c.csv"), ("campaign", "report", "--out", "{out}/r.html"),
)  # fmt: skip


def mutate_run(rng: np.random.Generator, folder: Path) -> str:
    """Change one thing in a run file, and say what."""
    file = folder / "run.nc"
    kind = rng.integers(6)
    if kind == 0:
        return _flip_bytes(rng, file)
    if kind == 1:
        return _write_odd_json(rng, folder / "summary.json")
    with h5py.File(file, "r+") as opened:
        if kind == 2:
            name, value = str(rng.choice(list(opened.attrs))), ODD[rng.integers(len(ODD))]
            opened.attrs[name] = value
            return f"attribute {name} = {value!r}"
        name = str(rng.choice([name for name in opened if not name.startswith("_")]))
        variable = opened[name]
        if kind == 3:
            del opened[name]
            return f"no variable {name}"
        if kind == 4 and variable.size:
            place = tuple(int(rng.integers(size)) for size in variable.shape)
            value = ODD[rng.integers(len(ODD))]
            if variable.dtype.hasobject:  # where h5py ends the process for a list
                value = str(value)
            try:
                variable[place] = value
            except (TypeError, ValueError, OverflowError, OSError) as error:
                return f"nothing: {error}"
            return f"{name}{place} = {value!r}"
        events = [json.loads(text) for text in opened["event"][()]]
        if not events:
            return "nothing"
        event = events[rng.integers(len(events))]
        key, value = str(rng.choice([*event, "new"])), ODD[rng.integers(len(ODD))]
        event[key] = value
        opened["event"][...] = [json.dumps(part) for part in events]
        return f"event {key} = {value!r}"


def mutate_scenario(rng: np.random.Generator, folder: Path) -> str:
    """Change the text of a scenario file."""
    file = folder / "mine.toml"
    lines = file.read_text().splitlines()
    k, kind = int(rng.integers(len(lines))), rng.integers(3)
    value = ODD[rng.integers(len(ODD))]
    if kind == 0:
        lines[k] = lines[k].partition("=")[0] + f"= {json.dumps(value)}"
    elif kind == 1:
        lines.insert(k, lines[int(rng.integers(len(lines)))])
    else:
        return _flip_bytes(rng, file)
    file.write_text("\n".join(lines))
    return f"line {k}: {lines[k][:60]}"


def mutate_campaign(rng: np.random.Generator, folder: Path) -> str:
    """Change a cell or the definition of a campaign."""
    file = folder / "campaign.sqlite"
    if rng.random() < 0.2:
        return _flip_bytes(rng, file)
    connection = sqlite3.connect(file)
    value = ODD[rng.integers(len(ODD))]
    if rng.random() < 0.5:
        (text,) = connection.execute("SELECT definition FROM campaign").fetchone()
        definition = json.loads(text)
        key = str(rng.choice(list(definition)))
        definition[key] = value
        connection.execute("UPDATE campaign SET definition = ?", (json.dumps(definition),))
        told = f"definition {key} = {value!r}"
    else:
        names = [row[1] for row in connection.execute("PRAGMA table_info(runs)")]
        name = str(rng.choice(names))
        plain = json.dumps(value) if isinstance(value, list) else value
        plain = str(plain) if isinstance(plain, int) and abs(plain) >= 2**63 else plain
        try:
            connection.execute(f'UPDATE runs SET "{name}" = ?', (plain,))
        except sqlite3.Error as error:
            told = f"nothing: {error}"
        else:
            told = f"cell {name} = {value!r}"
    connection.commit()
    connection.close()
    return told


def _flip_bytes(rng: np.random.Generator, file: Path) -> str:
    data = bytearray(file.read_bytes())
    places = rng.integers(len(data), size=int(rng.integers(1, 40)))
    for place in places:
        data[place] = int(rng.integers(256))
    file.write_bytes(data[: len(data) if rng.random() < 0.8 else int(places[0])])
    return f"{len(places)} bytes of {file.name}"


def _write_odd_json(rng: np.random.Generator, file: Path) -> str:
    summary = json.loads(file.read_text())
    key, value = str(rng.choice(list(summary))), ODD[rng.integers(len(ODD))]
    summary[key] = value
    file.write_text(json.dumps(summary))
    return f"summary {key} = {value!r}"


def use(words: list[str]) -> str:
    """Run a command; return what is wrong with how it ends, "" if nothing is."""
    began = process_time()
    signal.alarm(HANGS)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            result = CliRunner().invoke(typer.main.get_command(app), words)
    finally:
        signal.alarm(0)
    taken = process_time() - began
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        return f"{type(result.exception).__name__}: {result.exception}"
    if FAULT in result.output or "Traceback" in result.output:
        return next(line for line in result.output.splitlines() if FAULT in line or "Error" in line)
    if "\x1b" in result.output:
        return "writes an escape to the terminal"
    return f"takes {taken:.0f} s" if taken > LONGEST else ""


def main(
    count: Annotated[int, typer.Option(help="Files.")] = 300,
    seed: Annotated[int, typer.Option(help="Random seed.")] = 2026,
    first: Annotated[int, typer.Option(help="Number of the first file.")] = 0,
) -> None:
    """Mutate files, use them, and list what is wrong."""
    base = Path(tempfile.mkdtemp(prefix="mutate-"))
    kinds: list[tuple[Path, Callable[[np.random.Generator, Path], str], Any]] = []
    for name, overrides in SCENARIOS.items():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            sato.run(name, overrides=overrides).save(base / name)
        kinds += [(base / name, mutate_run, READS)] * 3
    (base / "text").mkdir()
    for name in ("crossing", "formation", "connectivity"):
        (base / "text" / "mine.toml").write_text(sato.read(name).to_toml())
        shutil.copytree(base / "text", base / f"text-{name}")
        kinds.append((base / f"text-{name}", mutate_scenario, (("show",),)))
    sato.campaign(
        "conflict", out=base / "campaign", trials=2, grid={"plan.step_s": [1.0, 2.0]}, workers=1
    ).close()
    kinds += [(base / "campaign", mutate_campaign, CAMPAIGN_READS)] * 4

    def give_up(*_: object) -> None:
        raise TimeoutError(f"hangs for {HANGS} s")

    signal.signal(signal.SIGALRM, give_up)
    wrong: Counter[str] = Counter()
    for number in range(first, first + count):
        rng = np.random.default_rng([seed, number])
        origin, mutate, reads = kinds[rng.integers(len(kinds))]
        folder, out = base / "used", base / "out"
        for place in (folder, out):
            shutil.rmtree(place, ignore_errors=True)
        shutil.copytree(origin, folder)
        out.mkdir()
        told = mutate(rng, folder)
        for words in reads:
            if rng.random() > SHARE and not {*SLOW}.isdisjoint(words):
                continue
            target = str(folder / "mine.toml") if mutate is mutate_scenario else str(folder)
            split = 2 if words[0] == "campaign" else 1
            rest = [word.format(out=out) for word in words[split:]]
            if problem := use([*words[:split], target, *rest]):
                wrong[problem[:60]] += 1
                print(f"{number}: {origin.name}, {told}: {' '.join(words)}: {problem}", flush=True)
    print(f"{count} files: {wrong.total()} uses wrong, {len(wrong)} kinds")
    shutil.rmtree(base)
    sys.exit(bool(wrong))


if __name__ == "__main__":
    typer.run(main)
