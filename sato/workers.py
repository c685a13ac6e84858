"""Worker processes, which are forked from one that has imported what they need."""

import multiprocessing
import signal
from typing import Any


def make_context(preloaded: list[str]) -> Any:
    """Return the context of processes that begin with some modules, where the system can fork."""
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(preloaded)
    return context


def describe_exit(code: int) -> str:
    """Name the signal that has ended a process, or its exit code."""
    return str(signal.strsignal(-code)) if code < 0 else f"exit code {code}"
