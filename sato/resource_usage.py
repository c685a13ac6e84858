"""Peak memory of a process, in a module that imports little."""

import sys
from contextlib import suppress


def peak_memory_mib() -> float:
    """Return the peak memory of this process [MiB]; NaN if the system does not report it."""
    try:
        import resource
    except ImportError:
        return float("nan")
    unit = 1 if sys.platform == "darwin" else 1024  # bytes there, KiB elsewhere
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 2**20


def reset_peak_memory() -> None:
    """Let the peak memory count from now on, where the system can (Linux)."""
    with suppress(OSError), open("/proc/self/clear_refs", "w") as file:
        file.write("5")  # proc(5): reset the peak resident set size
