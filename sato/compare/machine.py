"""What was measured on: the processor and the versions, and nothing that tells whose it is."""

import os
import platform
import re
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, packages_distributions, version
from pathlib import Path

from problems.solvers.adapter import Adapter

CPUS = Path("/proc/cpuinfo")
PACKAGE = re.compile(r"^[\w.-]+")  # in what pip is told: a name, without versions and extras
OURS = ("sato", "numpy", "scipy")


def machine(solvers: Iterable[Adapter]) -> dict[str, object]:
    """Processor, cores, Python, and the versions of the solvers' libraries."""
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "threads_per_solver": 1,
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "versions": _versions(list(solvers)),
    }


def _processor() -> str:
    if CPUS.is_file():
        for line in CPUS.read_text(errors="replace").split("\n"):
            name, _, value = line.partition(":")
            if name.strip() == "model name":
                return value.strip()
    return platform.processor() or platform.machine()


def _versions(solvers: Iterable[Adapter]) -> dict[str, str]:
    owners = packages_distributions()
    names = set(OURS)
    for solver in solvers:
        # Not every library says whose its module is; what installs it is mostly called so.
        names |= {*owners.get(solver.module.partition(".")[0], ()), *PACKAGE.findall(solver.pip)}
    found = {}
    for name in sorted(names):
        try:
            found[name] = version(name)
        except PackageNotFoundError:  # run from its folder and not installed
            continue
    return found
