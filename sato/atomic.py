"""Writing of files and folders, one or several together, whole or not at all.

A writer has a folder of its own, locked as long as it lives. What is new is written to `new` in it,
and what that replaces is moved to `former`. Several files are moved into place once `new` has
become `whole`. So the next command finishes or undoes what a killed one has begun.
"""

import fcntl
import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from errno import EEXIST, EISDIR, ENOTDIR
from pathlib import Path

from dynamics.errors import InputError

RECORD = "run.nc", "summary.json"  # files of a run
PREFIX = ".saving-"  # of folders in which files are written


@contextmanager
def replace_atomically(
    path: Path, old: Iterable[Path] = (), is_record: bool = False
) -> Iterator[Path]:
    """Yield a path to write a file or a folder to, and move it into place if all went well.

    Whatever is at the final path is kept until then, and replaced as a whole; a link is replaced
    itself, and what it leads to stays. The folder is made if it is missing. Old files beside it,
    which are listed once all is written, go with what is replaced. An `OSError` names the final
    path where nothing can be written.

    Raises:
        InputError: The path is that of a run's record or summary, which runs alone replace.
    """
    if path.name in RECORD and not is_record and path.exists():
        raise InputError("path", f"{path} is a part of a run; another name would do")
    try:
        final = Path(os.path.realpath(path.parent), path.name)
        if final.exists() and not (final.is_file() or final.is_dir()):
            raise FileExistsError(EEXIST, "is neither a file nor a folder, and stays as it is")
        make_folder(final.parent)
        with open_scratch(final.parent) as place:
            new, former = place / "new", place / "former"
            new.mkdir()
            former.mkdir()
            yield new / path.name
            # The system puts files in place of files and links alone.
            is_moved = (new / path.name).is_dir() if final.is_symlink() else final.is_dir()
            for gone in [*old, *[final] * is_moved]:
                with suppress(FileNotFoundError):  # another writer was faster
                    os.rename(gone, former / gone.name)
            os.replace(new / path.name, final)
    except OSError as error:
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error


def make_folder(folder: Path) -> None:
    """Make a folder where it is missing; an `OSError` says that it is a file."""
    if folder.exists() and not folder.is_dir():
        raise NotADirectoryError(ENOTDIR, "is a file, and the name of a folder would do")
    folder.mkdir(parents=True, exist_ok=True)


@contextmanager
def replace_together(folder: Path, old: Iterable[Path] = ()) -> Iterator[Path]:
    """Yield a new folder to write files to, and move all into a folder if all went well.

    They replace files of the same name, and others that are old. After an error or Ctrl-C there
    are either the former files or the new ones. A process that is killed while files are moved may
    leave a part of them, and never parts of both, until the next command puts the rest there. The
    folder is made if it is missing; an `OSError` names it where nothing can be written.
    """
    try:
        make_folder(folder)
        with open_scratch(folder) as place:
            new, former = place / "new", place / "former"
            new.mkdir()
            former.mkdir()
            yield new
            names = {path.name for path in new.iterdir()}
            for name in names:
                if (folder / name).is_dir():
                    raise IsADirectoryError(EISDIR, f"{name} is a folder, and stays as it is")
            for name in {path.name for path in old} | names:
                if os.path.lexists(folder / name):
                    os.rename(folder / name, former / name)
            os.rename(new, place / "whole")
    except OSError as error:
        raise OSError(error.errno, error.strerror or str(error), str(folder)) from error


@contextmanager
def open_scratch(folder: Path, prefix: str = PREFIX) -> Iterator[Path]:
    """Yield a new folder in a folder, locked as long as its process lives, which is removed."""
    remove_leftovers(folder, prefix)
    place, lock = _make_locked(folder, prefix)
    try:
        yield place
    finally:
        try:
            _settle(place)
        except KeyboardInterrupt:
            _settle(place)
            raise
        finally:
            os.close(lock)


def remove_leftovers(folder: Path, prefix: str = PREFIX) -> None:
    """Remove what processes that were killed have left in a folder, as far as that can be written.

    What they had begun to move is finished or undone.
    """
    for path in folder.glob(f"{prefix}*"):
        if path.is_dir() and not path.is_symlink():
            with suppress(OSError):
                lock = os.open(path, os.O_RDONLY)
                try:
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    # In a folder for all, such as /tmp, somebody else may put one there.
                    if path.stat().st_uid in (os.getuid(), folder.stat().st_uid):
                        _settle(path)
                    shutil.rmtree(path, ignore_errors=True)
                finally:
                    os.close(lock)


def is_held(path: Path) -> bool:
    """Tell whether a living process holds the lock of a file or a folder."""
    try:
        lock = os.open(path, os.O_RDONLY)
    except FileNotFoundError:
        return False
    try:
        fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:
        return True
    finally:
        os.close(lock)
    return False


def _settle(place: Path) -> None:
    """Move new files into place if all are whole, or else former ones back; remove the folder.

    What is there by now stays.
    """
    new, former, whole = (place / name for name in ("new", "former", "whole"))
    is_undone = new.is_dir() and any(new.iterdir())
    for source in (whole, former) if is_undone else (whole,):
        for path in source.iterdir() if source.is_dir() else ():
            if not os.path.lexists(final := place.parent / path.name):
                os.rename(path, final)
    shutil.rmtree(place, ignore_errors=True)


def _make_locked(folder: Path, prefix: str) -> tuple[Path, int]:
    # The folder itself is not locked: another program, such as `flock`, may hold it.
    while True:
        place = Path(tempfile.mkdtemp(prefix=prefix, dir=folder))
        with suppress(FileNotFoundError):  # taken for a leftover before it was locked
            lock = os.open(place, os.O_RDONLY)
            with suppress(OSError):  # of a file system without locks: there, leftovers stay
                fcntl.flock(lock, fcntl.LOCK_EX)
            if place.exists():
                return place, lock
            os.close(lock)
