"""Worker processes, which are forked from one that has imported what they need."""

import multiprocessing
import signal
import sys
from pathlib import Path
from typing import Any

from sato.scenario.errors import InputError


def make_context(preloaded: list[str]) -> Any:
    """Return the context of processes that begin with some modules, where the system can fork."""
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(preloaded)
    return context


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
