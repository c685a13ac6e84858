"""How a command ends: what went wrong in a sentence, and an exit code."""

import os
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NoReturn, TextIO

import typer

EXIT_OK, EXIT_FAILED, EXIT_USAGE = 0, 1, 2  # did what was asked; ran and did not; not even begun


@contextmanager
def report_errors() -> Iterator[None]:
    """Whatever goes wrong becomes a sentence and an exit code, and every warning a line."""
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _print_warning
            yield
    except (typer.Exit, typer.Abort):
        raise
    except KeyboardInterrupt:
        exit_with_message("interrupted before there was anything to keep", EXIT_FAILED)
    except ValueError as error:
        exit_with_message(str(error), EXIT_USAGE)
    except OSError as error:
        exit_with_message(f"{error.filename or 'a file'}: {error.strerror or error}", EXIT_FAILED)
    except RuntimeError as error:
        exit_with_message(str(error), EXIT_FAILED)
    except Exception as error:  # whatever is left; nobody at a terminal is shown a traceback
        if os.environ.get("SATO_TRACEBACK"):
            raise
        exit_with_message(
            f"this is a fault of the program, not of its input: {type(error).__name__}: {error} "
            "(SATO_TRACEBACK=1 shows where)",
            EXIT_FAILED,
        )


def _print_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    # Where in the program it arose is no help to who wrote the scenario.
    typer.echo(f"warning: {' '.join(str(message).split())}", err=True)


def exit_with_message(sentence: str, code: int) -> NoReturn:
    """Say why, and end with a code."""
    typer.echo(f"sato: {' '.join(sentence.split())}", err=True)
    raise typer.Exit(code)


def ensure_writable(folder: Path) -> None:
    """Only trying tells; what the attempt makes is taken away again.

    Raises:
        ValueError: Nothing can be written there.
    """
    made: list[Path] = []
    try:
        for part in reversed([folder, *folder.parents]):
            if not part.exists():
                part.mkdir()
                made.append(part)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise ValueError(
            f"{folder}: cannot be written to: {error.strerror}; --out takes another folder"
        ) from error
    finally:
        for part in reversed(made):
            part.rmdir()
