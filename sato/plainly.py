"""How a command ends: what went wrong in a sentence, and an exit code."""

import os
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NoReturn, TextIO

import typer

DONE, SHORT, REFUSED = 0, 1, 2  # did what was asked; ran and did not; not even begun


@contextmanager
def plainly() -> Iterator[None]:
    """Whatever goes wrong becomes a sentence and an exit code, and every warning a line."""
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _warn
            yield
    except (typer.Exit, typer.Abort):
        raise
    except KeyboardInterrupt:
        stop("interrupted before there was anything to keep", SHORT)
    except ValueError as error:
        stop(str(error), REFUSED)
    except OSError as error:
        stop(f"{error.filename or 'a file'}: {error.strerror or error}", SHORT)
    except RuntimeError as error:
        stop(str(error), SHORT)
    except Exception as error:  # whatever is left; nobody at a terminal is shown a traceback
        if os.environ.get("SATO_TRACEBACK"):
            raise
        stop(
            f"this is a fault of the program, not of its input: {type(error).__name__}: {error} "
            "(SATO_TRACEBACK=1 shows where)",
            SHORT,
        )


def _warn(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    # Where in the program it arose is no help to who wrote the scenario.
    typer.echo(f"warning: {' '.join(str(message).split())}", err=True)


def stop(sentence: str, code: int) -> NoReturn:
    """Say why, and end with a code."""
    typer.echo(f"sato: {' '.join(sentence.split())}", err=True)
    raise typer.Exit(code)


def refuse_unwritable(folder: Path) -> None:
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
