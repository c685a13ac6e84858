"""Public names of the packages `dynamics` and `problems`, and what importing them loads."""

import subprocess
import sys

import pytest

import dynamics
import problems


@pytest.mark.parametrize("package", [dynamics, problems])
def test_every_public_name_can_be_imported_from_its_package(package):
    for name in dir(package):
        assert getattr(package, name).__module__.startswith(package.__name__)


@pytest.mark.parametrize("package", ["dynamics", "problems"])
def test_importing_a_package_loads_no_heavy_library(package):
    code = f"import sys, {package}; print({{'scipy', 'casadi', 'numba'}} & set(sys.modules))"
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert shown.stdout.strip() == "set()"
