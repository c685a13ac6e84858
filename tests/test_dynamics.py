"""Public names of the package `dynamics`, and what importing it loads."""

import subprocess
import sys

import dynamics


def test_dir_lists_the_public_names_and_nothing_else():
    assert dir(dynamics) == sorted(dynamics.__all__)
    assert all(getattr(dynamics, name).__module__.startswith("dynamics.") for name in dir(dynamics))


def test_importing_the_package_loads_no_heavy_library():
    code = "import dynamics, sys; print({'scipy', 'casadi', 'numba'} & set(sys.modules))"
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert shown.stdout.strip() == "set()"
