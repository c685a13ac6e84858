"""End commands at random instants, or on a full disk: python scripts/interrupt_commands.py.

Each of run, plot, animate and export is started over an earlier result, and ended by kill -9, by
Ctrl-C, or by a limit on the size of files. Exit code 1 where a file under a final name is neither
the earlier nor a whole new one, or a command crashed.
"""

import argparse
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from time import sleep

import numpy as np

SCENARIO = "crossing"
COMMANDS = {
    "run": ["run", SCENARIO, "--out", "here", "--quiet"],
    "plot": ["plot", "here"],
    "animate": ["animate", "here"],
    "export": ["export", "here", "--format", "csv"],
}
SUFFIXES = (".nc", ".json", ".png", ".gif", ".mp4", ".csv")


def start(command: str, home: Path, size: int | None = None) -> subprocess.Popen[str]:
    """Start a command, with a limit on the size of files if there is one [byte]."""

    def limit() -> None:
        signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in the background
        if size is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))

    words = [sys.executable, "-m", "sato", *COMMANDS[command]]
    out = subprocess.PIPE
    return subprocess.Popen(words, cwd=home, stdout=out, stderr=out, text=True, preexec_fn=limit)


def contents(home: Path) -> dict[str, bytes]:
    """Read the files under final names."""
    return {p.name: p.read_bytes() for p in (home / "here").iterdir() if p.suffix in SUFFIXES}


def is_whole(name: str, content: bytes, home: Path) -> bool:
    """Tell whether a new file is complete."""
    if name == "run.nc":
        return start("export", home).wait() == 0
    ends = {".json": b"}\n", ".png": b"IEND\xaeB`\x82", ".gif": b";", ".csv": b"\n"}
    return len(content) > 100 and content.endswith(ends.get(Path(name).suffix, b""))


def find_faults(command: str, ended: str, before: dict[str, bytes], home: Path) -> list[str]:
    """List the files that are neither the earlier nor whole."""
    after = contents(home)
    faults = [f"{name} is gone" for name in before if name not in after]
    if command == "run":  # a summary is not there while the run beside it is another
        faults = [fault for fault in faults if not fault.startswith("summary.json")]
    for name, content in after.items():
        if content != before.get(name) and not is_whole(name, content, home):
            faults.append(f"{name} is half written")
    return [f"{command}, {ended}: {fault}" for fault in faults]


def main() -> int:
    """End each command many times."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--times", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    rng, faults = np.random.default_rng(given.seed), []
    home = Path(tempfile.mkdtemp())
    (home / "here").mkdir()
    for command in COMMANDS:
        process = start(command, home)
        if process.wait() != 0:
            print(process.communicate()[1])
            return 1
    for command in COMMANDS:
        for how in ("kill -9", "Ctrl-C", "full disk"):
            outcomes = []
            for _ in range(given.times):
                before = contents(home)
                largest = max(map(len, before.values()))
                size = int(largest ** rng.uniform(0, 1)) if how == "full disk" else None
                process = start(command, home, size)
                if size is None:
                    sleep(rng.uniform(0.6, 6.0))
                    process.send_signal(signal.SIGKILL if how == "kill -9" else signal.SIGINT)
                said = process.communicate()[1]
                ended = f"{how}, exit {process.returncode}"
                outcomes.append(process.returncode)
                faults += find_faults(command, ended, before, home)
                is_early = process.returncode == -signal.SIGINT and not said  # before Python began
                is_crash = "Traceback" in said or (process.returncode < 0 and not is_early)
                if how != "kill -9" and is_crash:
                    faults.append(f"{command}, {ended}: {said[-300:]}")
            print(f"{command}, {how}: exit codes {outcomes}", flush=True)
    print(*(faults or ["no fault"]), sep="\n")
    shutil.rmtree(home)
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
