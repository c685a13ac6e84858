"""Command line: `sato`, and `python -m sato`."""

import signal
import sys

import sato


def main() -> None:
    """Run the command line."""
    # While modules load, Ctrl-C has nothing to lose, and an exception would print where it arose.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        sato.check_packages()
    except ImportError as error:
        sys.exit(f"sato: {error}")
    from sato.cli import main as run

    run()


if __name__ == "__main__":
    main()
