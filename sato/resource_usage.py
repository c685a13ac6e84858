"""What a process has held in memory; light, so that anybody can ask."""

import sys


def peak_memory_mib() -> float:
    """The most memory that this process has held [MiB]; NaN where the system does not say."""
    try:
        import resource
    except ImportError:
        return float("nan")
    unit = 1 if sys.platform == "darwin" else 1024  # bytes there, KiB elsewhere
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 2**20
