"""End commands at random instants, or on a full disk: python scripts/interrupt_commands.py.

Each command is started over an earlier result, in a process that is forked from this one, so that
it has imported everything and begins with its work. Half are ended at any instant, half while they
write. Then another command is run in the folder: `check`, or the same again. Exit code 1 where a
file is half written, an earlier result is gone without a new one, what was said to be saved is not
there, or anything is left over afterwards: folders of writers, temporary ones, processes.
"""

import argparse
import atexit
import json
import os
import re
import resource
import shutil
import signal
import sys
import tempfile
import traceback
import warnings
from collections import Counter
from contextlib import suppress
from pathlib import Path
from time import monotonic, sleep
from typing import Any, NamedTuple

import numpy as np
import psutil
from PIL import Image

import sato
from sato import cli
from sato.campaigns.table import open_table
from sato.record import RUN_FILE, SUMMARY_FILE, find_drawn
from sato.run_file import read_run_file

# So short that a film of it takes a second.
TINY = ["swarm.start={kind='points', positions_m=[[-5, 0], [5, 0.1]]}", "plan.horizon_steps=2"]
TINY += ["plan.auction_steps=2", "leg.0.steps=4"]
TINY += ["leg.0.shape={kind='points', positions_m=[[-4.9, 0], [5, 0]]}"]
ORBIT = ["swarm.agents=2"]
CAMPAIGN = '[campaign]\nscenario = "tiny.toml"\nkeep = "all"\ntrials = 6\n'
FIRST_ROWS = 2  # of the campaign before it is interrupted
LEFT_TIME = 30.0  # within which processes end by themselves once their parent is killed [s]
PATIENCE = 600.0  # for a command [s]
POLL = 2e-4  # between two looks at a folder [s]


class Case(NamedTuple):
    """Command to be ended."""

    words: str  # of the command line; S stands for a seed
    folder: str = "here"
    following: str = "check here"  # every other time; else, or if none, the same
    is_group: bool = False  # its processes are ended with it


CASES = {
    "run": Case("run tiny.toml --out here --seed S"),
    "plot": Case("plot here"),
    "animate": Case("animate here"),
    "player": Case("player here"),
    "export": Case("export orbit", "orbit", "check orbit"),
    "check": Case("check here"),
    "campaign": Case("campaign run c.toml --out camp --resume", "camp", ""),
    # Whose temporary files are removed by their kind alone.
    "processes": Case("run tiny.toml --out here --seed S --processes", following=""),
    "group": Case("run tiny.toml --out here --seed S --processes", "here", "", is_group=True),
}
HOW = ("kill", "interrupt", "full")


class Ended(NamedTuple):
    """End of a command."""

    code: int  # of its exit; minus the signal
    said: str
    complained: str


class Trial:
    """Command in a process, over a copy of earlier results."""

    def __init__(self, home: Path, words: str, size: int | None = None) -> None:
        self.home, self.began, self.at = home, monotonic(), os.stat(home).st_mtime_ns
        (home / "began").touch()
        self.at = (home / "began").stat().st_mtime_ns
        self.pid = os.fork()
        if not self.pid:
            _become(home, words, size)

    def end(self, sent: int | None, is_group: bool = False) -> Ended:
        """Send a signal, or let the command go on until it ends; return how it ended."""
        if sent is not None:
            (os.killpg if is_group else os.kill)(self.pid, sent)
        until = monotonic() + PATIENCE
        while not (ended := os.waitpid(self.pid, os.WNOHANG))[0]:
            if monotonic() > until:
                os.killpg(self.pid, signal.SIGKILL)
            sleep(POLL)
        self.took = monotonic() - self.began
        texts = [(self.home / name).read_text() for name in ("out", "err")]
        return Ended(os.waitstatus_to_exitcode(ended[1]), *texts)

    def wait_until_it_writes(self, folder: str) -> float:
        """Wait for a writer's folder, or the end; return the time since the start [s]."""
        while not any((self.home / folder).glob(".saving-*")):
            if os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT):
                break
            sleep(POLL)
        return monotonic() - self.began

    def left_processes(self) -> list[str]:
        """List what still runs of the command, once it has had the time to end."""
        until = monotonic() + LEFT_TIME
        while left := [p for p in psutil.process_iter() if _is_of(p, self.pid)]:
            if monotonic() > until:
                told = [f"process {p.pid} still runs: {_words(p)}" for p in left]
                for process in left:
                    with suppress(psutil.Error):  # that has ended meanwhile
                        process.kill()
                return told
            sleep(0.02)
        return []


def _is_of(process: psutil.Process, session: int) -> bool:
    try:
        return os.getsid(process.pid) == session and process.status() != psutil.STATUS_ZOMBIE
    except (OSError, psutil.Error):
        return False


def _words(process: psutil.Process) -> list[str]:
    with suppress(psutil.Error):
        return process.cmdline()
    return []


def _become(home: Path, words: str, size: int | None) -> None:
    os.setsid()
    os.chdir(home)
    for number, name in enumerate(("out", "err"), 1):
        os.dup2(os.open(name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), number)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    tempfile.tempdir = os.environ["TMPDIR"] = str(home / "tmp")
    warnings.resetwarnings()
    if size is not None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))
    sys.argv = ["sato", *words.split()]
    code: Any = 70
    try:
        cli.main()
    except SystemExit as error:
        code = error.code or 0
    except BaseException:
        traceback.print_exc()
    atexit._run_exitfuncs()
    sys.stdout.flush()
    os._exit(code)  # without taking apart all that was imported


def contents(folder: Path) -> dict[str, bytes]:
    """Read the files under final names."""
    paths = (p for p in folder.rglob("*") if p.is_file() and ".saving-" not in str(p))
    return {str(p.relative_to(folder)): p.read_bytes() for p in paths}


def is_whole(path: Path) -> bool:
    """Tell whether a file is complete, by its kind."""
    try:
        if path.suffix == ".nc":
            read_run_file(path)
        elif path.suffix == ".json":
            json.loads(path.read_text())
        elif path.suffix in (".png", ".gif"):
            with Image.open(path) as picture:
                for number in range(getattr(picture, "n_frames", 1)):
                    picture.seek(number)
                    picture.load()
        elif path.suffix == ".html":
            return path.read_text().endswith("-->\n")
        return path.read_bytes().endswith(b"\n") or path.suffix != ".oem"
    except Exception:  # whatever a damaged file makes its reader raise
        return False


def digest_of(folder: Path) -> str:
    """Return the digest of the run in a folder."""
    return str(read_run_file(folder / RUN_FILE).attrs["digest"])


def find_half_written(folder: Path, before: dict[str, bytes]) -> list[str]:
    """List the files that are neither the earlier nor whole."""
    new = (name for name, content in contents(folder).items() if content != before.get(name))
    kinds = (".nc", ".json", ".png", ".gif", ".mp4", ".html", ".oem")
    faults = [n for n in new if Path(n).suffix in kinds and not is_whole(folder / n)]
    return [f"{name} is half written" for name in faults]


def find_lost(folder: Path, before: dict[str, bytes], digest: str) -> list[str]:
    """List what is gone, or does not belong together, of a folder that had a run of a digest."""
    there, now = contents(folder), digest_of(folder)
    faults = [f"{name} is gone" for name in before if name not in there and now == digest]
    others = set(find_drawn(folder)) - set(find_drawn(folder, now))
    faults += [f"{path.name} is of another run" for path in others]
    if (folder / SUMMARY_FILE).exists():
        if json.loads((folder / SUMMARY_FILE).read_text())["digest"] != now:
            faults.append("the summary is of another run")
    return faults


def find_unsaved(home: Path, said: str, since: int) -> list[str]:
    """List what was said to be saved, and is not there as it was then."""
    places = [home / line for line in said.splitlines() if line and (home / line).exists()]
    files = [place / RUN_FILE if (place / RUN_FILE).exists() else place for place in places]
    files = [max(f.iterdir(), key=os.path.getmtime) if f.is_dir() else f for f in files]
    return [f"{f.name} was not saved" for f in files if f.stat().st_mtime_ns < since]


def find_missing_rows(folder: Path, complained: str) -> list[str]:
    """List the rows of a campaign that were said to be flown, and are not there whole."""
    told = [int(text) for text in re.findall(r"^(\d+)/\d+", complained, re.MULTILINE)]
    with open_table(folder) as table:
        rows = [row["row"] for row in table.rows(["row"])]
    missing = FIRST_ROWS if not told else max(told)
    faults = [f"{missing} rows were told, {len(rows)} are there"] if len(rows) < missing else []
    runs = [folder / "runs" / str(row) / RUN_FILE for row in rows]
    return faults + [f"{run} is not whole" for run in runs if not (run.exists() and is_whole(run))]


def find_leftovers(home: Path) -> list[str]:
    """List the folders of writers, and what is in the temporary one."""
    left = [*home.rglob(".saving-*"), *(home / "tmp").iterdir()]
    return [f"{path.relative_to(home)} is left over" for path in left]


def try_once(
    name: str, how: str, home: Path, took: float, rng: Any, number: int
) -> tuple[int, list[str]]:
    """End a command once, and run the next one; return how it ended, and the faults."""
    case = CASES[name]
    folder, words = home / case.folder, case.words.replace("S", str(number + 1))
    before, digest = contents(folder), "" if name == "campaign" else digest_of(folder)
    size = int(10 ** rng.uniform(2, 6.5)) if how == "full" else None
    trial, instant = Trial(home, words, size), rng.uniform(0, took)
    if how != "full":
        if number % 2:
            since = trial.wait_until_it_writes(case.folder)
            instant = rng.uniform(0, max(took - since, 0.02))
        sleep(instant)
    sent = {"kill": signal.SIGKILL, "interrupt": signal.SIGINT, "full": None}[how]
    ended = trial.end(sent, case.is_group)
    faults = trial.left_processes() + find_half_written(folder, before)
    faults += find_unsaved(home, ended.said, trial.at)
    is_crash = ended.code < 0 and how != "kill" and ended.complained
    if is_crash or any(word in ended.complained for word in ("Traceback", "fault of the")):
        faults.append(f"complained: {ended.complained[-300:]}")
    if name == "campaign":
        faults += find_missing_rows(folder, ended.complained)
    next_words = case.following if number % 4 < 2 and case.following else words
    after = Trial(home, next_words)
    done = after.end(None)
    if done.code:
        faults.append(f"then `{next_words}` ended with {done.code}: {done.complained[-300:]}")
    faults += after.left_processes() + find_leftovers(home) + find_half_written(folder, before)
    if name == "campaign":
        faults += find_missing_rows(folder, done.complained)
    else:
        faults += find_lost(folder, before, digest)
    return ended.code, faults


def prepare(home: Path) -> None:
    """Write the results over which commands are ended."""
    (home / "tmp").mkdir(parents=True)
    for name, source, changes in (
        ("tiny", "crossing", TINY),
        ("orbit", "random_cw", ORBIT),
    ):
        (home / f"{name}.toml").write_text(sato.read(source, changes).to_toml())
    (home / "c.toml").write_text(CAMPAIGN)
    flown = sato.run(str(home / "tiny.toml"))  # imports and compiles all that is needed, once
    flown.save(home / "warm")
    loaded = sato.load(home / "warm")
    loaded.plot(home / "warm")
    loaded.animate(home / "warm")
    loaded.player(home / "warm" / "player.html")
    assert loaded.report.kept
    shutil.rmtree(home / "warm")
    first = [f"campaign run c.toml --out camp --trials {FIRST_ROWS}", "run orbit.toml --out orbit"]
    first += ["run tiny.toml --out here", "plot here", "animate here", "player here"]
    for words in [*first, "export orbit"]:
        ended = Trial(home, words).end(None)
        if ended.code or find_leftovers(home):
            left = find_leftovers(home)
            raise SystemExit(f"`{words}` ended with {ended.code}: {ended.complained}{left}")


def main() -> int:
    """End each command many times."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cases", nargs="*", choices=[[], *CASES], metavar="CASE")
    parser.add_argument("--how", choices=HOW, action="append")
    parser.add_argument("--times", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--verbose", action="store_true", help="a line each time")
    given = parser.parse_args()
    place = Path(tempfile.mkdtemp(prefix="interrupted-"))
    prepare(place / "first")
    faults = 0
    for how in given.how or HOW:
        for name in given.cases or CASES:
            rng, codes = np.random.default_rng(given.seed), Counter[int]()
            took = 0.0
            for number in range(-1, given.times):
                home = place / "home"
                shutil.rmtree(home, ignore_errors=True)
                shutil.copytree(place / "first", home)
                if number < 0:  # undisturbed, to learn its length
                    trial = Trial(home, CASES[name].words.replace("S", "0"))
                    trial.end(None)
                    took = 1.05 * trial.took
                    continue
                code, found = try_once(name, how, home, took, rng, number)
                codes[code] += 1
                faults += len(found)
                if given.verbose:
                    print(f"{name}, {how}, {number}: exit {code}", flush=True)
                for fault in found:
                    print(f"{name}, {how}, {number}, exit {code}: {fault}", flush=True)
            print(f"{name}, {how}, of {took:.2f} s: exit codes {dict(codes)}", flush=True)
    print(f"{faults} faults")
    shutil.rmtree(place)
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
