"""End of a command: errors as one sentence, and exit codes."""

import os
import signal
import sys
import warnings
from _thread import interrupt_main
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from shutil import rmtree
from tempfile import TemporaryFile, mkdtemp
from threading import Timer
from typing import TYPE_CHECKING, Any

import typer
from typer.core import TyperGroup

from sato.scenario.errors import InputError, ScenarioError, explain
from sato.terminal import echo, use_ascii_where_needed

if TYPE_CHECKING:
    from sato.runs import Run

# Did what was asked; ran, but did not reach it; refused before anything was done.
EXIT_OK, EXIT_FAILED, EXIT_USAGE = 0, 1, 2
EXIT_UNREAD = 128 + 13  # the reader of the output has gone, as shells say of SIGPIPE


class CommandGroup(TyperGroup):
    """Commands whose errors and warnings become one line each on the error stream."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Refuse empty words: `--out ""` would be the current folder."""
        if "" in args:
            raise typer.BadParameter("a word is empty, as of a variable of the shell without value")
        return super().parse_args(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        """Run a command."""
        use_ascii_where_needed()
        try:
            with _interrupts_raised(), warnings.catch_warnings():
                warnings.showwarning = _print_warning
                return super().invoke(ctx)
        except BrokenPipeError:
            # The reader of the output closed it, as `head` does. At exit, the interpreter would
            # write the rest of its buffer, and complain.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            raise typer.Exit(EXIT_UNREAD) from None
        except (Exception, KeyboardInterrupt) as error:
            if type(error).__module__.startswith(("click", "typer")):
                if hasattr(error.__cause__, "errors"):  # of pydantic, which Typer converts with
                    setattr(error, "message", explain(error.__cause__).reason)  # noqa: B010
                raise
            exec("")  # Python ends itself by the signal where one arose in code from a string
            sentence, code = _describe(error)
            echo(f"sato: {' '.join(sentence.split())}", err=True)
            raise typer.Exit(code) from None


@contextmanager
def _interrupts_raised() -> Iterator[None]:
    # Ctrl-C raises KeyboardInterrupt in a command, and does nothing once its work is done.
    if signal.getsignal(signal.SIGINT) != signal.SIG_DFL:
        yield
        return
    sys.unraisablehook = _raise_again
    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)


def _raise_again(unraisable: Any) -> None:
    # Python drops what is raised in a callback, such as that of a weak reference.
    if unraisable.exc_type is KeyboardInterrupt:
        Timer(0.01, interrupt_main).start()
    else:
        sys.__unraisablehook__(unraisable)


def ensure_writable(folder: Path) -> None:
    """Refuse a folder where nothing can be written, neither in it nor where it is to be."""
    try:
        existing = next(path for path in (folder, *folder.parents) if path.exists())
        TemporaryFile(dir=existing).close()  # of which nothing is left, however a process ends
    except OSError as error:
        reason = f"{folder}: cannot be written to: {error.strerror}; --out takes another place"
        raise InputError("", reason) from error


def save_somewhere(flown: "Run", folder: Path) -> None:
    """Save a run, if not where it is to be, in a temporary folder, so that no flight is lost."""
    try:
        flown.save(folder)
    except OSError as error:
        spare = mkdtemp(prefix="sato-")
        try:
            flown.save(spare)
        except OSError:
            rmtree(spare)
            raise error from None
        echo(f"sato: {_describe(error)[0]}; the run is in {spare}", err=True)
        raise typer.Exit(EXIT_FAILED) from error


def _describe(error: BaseException) -> tuple[str, int]:
    if isinstance(error, KeyboardInterrupt):
        return "interrupted; every file is whole, the earlier or the new one", EXIT_FAILED
    from sato.record import RunFileError

    if isinstance(error, OSError):
        return f"{error.filename or 'the output'}: {error.strerror or error}", EXIT_FAILED
    if isinstance(error, InputError | ScenarioError | RunFileError):
        return str(error), EXIT_USAGE
    if isinstance(error, RuntimeError):  # a mathematical outcome, such as Infeasible
        return str(error), EXIT_FAILED
    if os.environ.get("SATO_TRACEBACK"):
        raise error
    fault = f"this is a fault of the program, not of its input: {type(error).__name__}: {error}"
    return f"{fault} (SATO_TRACEBACK=1 shows where)", EXIT_FAILED


def _print_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    # The line of the program where it arose does not help the author of a scenario.
    echo(f"warning: {' '.join(str(message).split())}", err=True)
