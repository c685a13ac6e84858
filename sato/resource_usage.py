"""Peak memory of a process, in a module that imports little."""

import sys


def peak_memory_mib() -> float:
    """Return the peak memory of this process [MiB]; NaN if the system does not report it."""
    try:
        import resource
    except ImportError:
        return float("nan")
    unit = 1 if sys.platform == "darwin" else 1024  # bytes there, KiB elsewhere
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 2**20
