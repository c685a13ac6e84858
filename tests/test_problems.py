"""Public names of the package `problems`."""

import subprocess
import sys

import problems


def test_every_public_name_can_be_imported():
    for name in dir(problems):
        assert getattr(problems, name).__name__ == name


def test_importing_the_package_imports_no_solver():
    code = "import sys, problems; dir(problems); print('clarabel' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
