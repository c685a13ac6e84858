"""Run every built-in scenario with an installed command.

python scripts/try_wheel.py PATH/TO/sato
"""

import subprocess
import sys
import tempfile


def main(command: str) -> None:
    """List the scenarios, run each in its own folder, and verify the run from its file."""
    listed = subprocess.run([command, "scenarios"], check=True, capture_output=True, text=True)
    names = [line.split()[0] for line in listed.stdout.splitlines() if line.strip()]
    for name in names:
        with tempfile.TemporaryDirectory() as folder:
            # Exit code 1 says that a promise was broken, as some scenarios are built to show.
            flown = subprocess.run([command, "run", name, "--quiet", "--out", folder], check=False)
            checked = subprocess.run(
                [command, "check", folder], check=False, capture_output=True, text=True
            )
        print(f"{name}: run exited {flown.returncode}, check {checked.returncode}", flush=True)
        if max(flown.returncode, checked.returncode) > 1:
            raise SystemExit(f"{name} could not be flown: {checked.stderr}")


if __name__ == "__main__":
    main(sys.argv[1])
