"""End of a command: errors as one sentence, and exit codes."""

import os
import sys
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn, TextIO

import typer
from typer.core import TyperGroup

# Did what was asked; ran, but did not reach it; refused before anything was done.
EXIT_OK, EXIT_FAILED, EXIT_USAGE = 0, 1, 2


class CommandGroup(TyperGroup):
    """Commands whose errors and warnings become one line each on the error stream."""

    def invoke(self, ctx: Any) -> Any:
        """Run a command."""
        with report_errors():
            return super().invoke(ctx)


@contextmanager
def report_errors() -> Iterator[None]:
    """Turn errors into one sentence and an exit code, and warnings into one line each."""
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _print_warning
            yield
    except KeyboardInterrupt:
        exit_with_message("interrupted before there was anything to keep", EXIT_FAILED)
    except BrokenPipeError:
        # The reader of the output closed it, as `head` does. At exit, the interpreter would
        # write the rest of its buffer, and complain.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise typer.Exit(EXIT_FAILED) from None
    except OSError as error:
        exit_with_message(f"{error.filename or 'a file'}: {error.strerror or error}", EXIT_FAILED)
    except Exception as error:
        if type(error).__module__.startswith(("click", "typer")):
            raise
        if _is_refusal(error):
            exit_with_message(str(error), EXIT_USAGE)
        if isinstance(error, RuntimeError):  # a mathematical outcome, such as Infeasible
            exit_with_message(str(error), EXIT_FAILED)
        if os.environ.get("SATO_TRACEBACK"):
            raise
        exit_with_message(
            f"this is a fault of the program, not of its input: {type(error).__name__}: {error} "
            "(SATO_TRACEBACK=1 shows where)",
            EXIT_FAILED,
        )


def exit_with_message(sentence: str, code: int) -> NoReturn:
    """Print a sentence to the error stream, and exit."""
    typer.echo(f"sato: {' '.join(sentence.split())}", err=True)
    raise typer.Exit(code)


def ensure_writable(folder: Path) -> None:
    """Try to write into a folder, and remove what that makes.

    Raises:
        InputError: Nothing can be written there.
    """
    from sato.scenario.errors import InputError

    made: list[Path] = []
    try:
        for part in reversed([folder, *folder.parents]):
            if not part.exists():
                part.mkdir()
                made.append(part)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        reason = f"{folder}: cannot be written to: {error.strerror}; --out takes another folder"
        raise InputError("", reason) from error
    finally:
        for part in reversed(made):
            part.rmdir()


def _is_refusal(error: Exception) -> bool:
    from sato.record import RunFileError
    from sato.scenario.errors import InputError, ScenarioError

    return isinstance(error, InputError | ScenarioError | RunFileError)


def _print_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    # The line of the program where it arose does not help the author of a scenario.
    typer.echo(f"warning: {' '.join(str(message).split())}", err=True)
