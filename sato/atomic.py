"""Writing of files and folders, one or several together, whole or not at all."""

import fcntl
import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from errno import EEXIST, EISDIR
from pathlib import Path

PREFIX = ".saving-"  # of folders in which files are written


@contextmanager
def replace_atomically(path: Path) -> Iterator[Path]:
    """Yield a path to write a file or a folder to, and move it into place if all went well.

    Whatever is at the final path is kept until then, and replaced as a whole; a link is replaced
    itself, and what it leads to stays. The folder is made if it is missing. An `OSError` names the
    final path where nothing can be written.
    """
    try:
        final = Path(os.path.realpath(path.parent), path.name)
        if final.exists() and not (final.is_file() or final.is_dir()):
            raise FileExistsError(EEXIST, "is neither a file nor a folder, and stays as it is")
        final.parent.mkdir(parents=True, exist_ok=True)
        with _scratch(final.parent) as place:
            new, old = place / path.name, place / f".{path.name}"
            yield new
            try:
                # The system puts files in place of files and links alone.
                if new.is_dir() if final.is_symlink() else final.is_dir():
                    os.rename(final, old)
                os.replace(new, final)
            except BaseException:
                if os.path.lexists(old) and not os.path.lexists(final):
                    os.rename(old, final)
                raise
    except OSError as error:
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error


@contextmanager
def replace_together(folder: Path, old: Iterable[Path] = ()) -> Iterator[Path]:
    """Yield a new folder to write files to, and move all into a folder if all went well.

    They replace files of the same name, and others that are old. After an error or Ctrl-C all
    are as before. A process that is killed while files are moved may leave a part of the new
    ones, or of the former ones, and never parts of both. The folder is made if it is missing; an
    `OSError` names it where nothing can be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with _scratch(folder) as place:
            new, former = place / "new", place / "former"
            new.mkdir()
            former.mkdir()
            yield new
            names = {path.name for path in new.iterdir()}
            for name in names:
                if (folder / name).is_dir():
                    raise IsADirectoryError(EISDIR, f"{name} is a folder, and stays as it is")
            gone = {path.name for path in old} | {
                name for name in names if (folder / name).exists()
            }
            try:
                for name in gone:
                    os.rename(folder / name, former / name)
                for name in names:
                    os.rename(new / name, folder / name)
            except BaseException:
                for name in names - {path.name for path in new.iterdir()}:
                    (folder / name).unlink()
                for path in former.iterdir():
                    os.rename(path, folder / path.name)
                raise
    except OSError as error:
        raise OSError(error.errno, error.strerror or str(error), str(folder)) from error


def remove_leftovers(folder: Path) -> None:
    """Remove what writers that were killed have left in a folder, as far as that can be written."""
    for path in folder.glob(f"{PREFIX}*"):
        if path.is_dir() and not path.is_symlink():
            with suppress(OSError):
                lock = os.open(path, os.O_RDONLY)
                try:
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    shutil.rmtree(path, ignore_errors=True)
                finally:
                    os.close(lock)


@contextmanager
def _scratch(folder: Path) -> Iterator[Path]:
    """Yield a new folder in a folder, locked as long as its writer lives, which is removed."""
    remove_leftovers(folder)
    place, lock = _make_locked(folder)
    try:
        yield place
    finally:
        shutil.rmtree(place, ignore_errors=True)
        os.close(lock)


def _make_locked(folder: Path) -> tuple[Path, int]:
    # The folder itself is not locked: another program, such as `flock`, may hold it.
    while True:
        place = Path(tempfile.mkdtemp(prefix=PREFIX, dir=folder))
        with suppress(FileNotFoundError):  # taken for a leftover before it was locked
            lock = os.open(place, os.O_RDONLY)
            with suppress(OSError):  # of a file system without locks: there, leftovers stay
                fcntl.flock(lock, fcntl.LOCK_EX)
            if place.exists():
                return place, lock
            os.close(lock)
