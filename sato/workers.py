"""Worker processes, which are forked from one that has imported what they need."""

import multiprocessing
import signal
import sys
from contextlib import ExitStack
from functools import cache
from multiprocessing.util import Finalize
from pathlib import Path
from tempfile import gettempdir
from typing import Any

from sato.atomic import open_scratch
from sato.scenario.errors import InputError

PREFIX = "sato-w-"  # of folders with sockets of processes; short, for their paths have 107 letters


def make_context(preloaded: list[str]) -> Any:
    """Return the context of processes that begin with some modules, where the system can fork."""
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(preloaded)
    return context


@cache
def place_sockets() -> None:
    """Put the sockets of processes where the next command finds them, if this one is killed."""
    process: Any = multiprocessing.current_process()
    if "tempdir" not in process._config:
        stack = ExitStack()
        folder = stack.enter_context(open_scratch(Path(gettempdir()), PREFIX))
        process._config["tempdir"] = str(folder)
        Finalize(None, stack.close, exitpriority=-100)  # after those that use it


def check_guard() -> None:
    """Refuse to start processes from a script that would start them again in each of them."""
    file = getattr(sys.modules["__main__"], "__file__", None)
    if file is None or not Path(file).is_file():
        return
    if "__main__" not in Path(file).read_text(encoding="utf-8", errors="ignore"):
        reason = "each process that it starts imports it, and would start others"
        cure = 'a line `if __name__ == "__main__":` above what starts them would do'
        raise InputError("", f"{file}: {reason}; {cure}")


def describe_exit(code: int) -> str:
    """Name the signal that has ended a process, or its exit code."""
    return str(signal.strsignal(-code)) if code < 0 else f"exit code {code}"
