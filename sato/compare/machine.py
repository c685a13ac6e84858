"""Description of the machine: processor and versions, and nothing that identifies its owner."""

import os
import platform
import re
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, packages_distributions, version
from pathlib import Path

from problems.solvers.adapter import SolverAdapter

CPUINFO = Path("/proc/cpuinfo")
PACKAGE_NAME = re.compile(r"^[\w.-]+")  # name in a pip requirement, without version and extras
OWN_PACKAGES = ("sato", "numpy", "scipy")


def describe_machine(solvers: Iterable[SolverAdapter]) -> dict[str, object]:
    """Return processor, cores, Python version, and the versions of the solvers' libraries."""
    return {
        "processor": _processor_name(),
        "cores": os.cpu_count(),
        "threads_per_solver": 1,
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "versions": _package_versions(solvers),
    }


def _processor_name() -> str:
    if CPUINFO.is_file():
        for line in CPUINFO.read_text(errors="replace").split("\n"):
            name, _, value = line.partition(":")
            if name.strip() == "model name":
                return value.strip()
    return platform.processor() or platform.machine()


def _package_versions(solvers: Iterable[SolverAdapter]) -> dict[str, str]:
    distributions = packages_distributions()
    names = set(OWN_PACKAGES)
    for solver in solvers:
        # Not every library declares its modules; the name that pip installs is mostly the same.
        names |= {
            *distributions.get(solver.module.partition(".")[0], ()),
            *PACKAGE_NAME.findall(solver.pip_packages),
        }
    versions = {}
    for name in sorted(names):
        try:
            versions[name] = version(name)
        except PackageNotFoundError:  # run from a folder without being installed
            continue
    return versions
