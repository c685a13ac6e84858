"""Writing of files and folders, whole or not at all."""

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def replace_atomically(path: Path) -> Iterator[Path]:
    """Yield a path to write a file or a folder to, and move it into place if all went well.

    Whatever is at the final path is kept until then, and replaced as a whole.

    Args:
        path: Final path; its folder is made if it is missing.

    Raises:
        OSError: Nothing can be written there; the error names the final path.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".saving-", dir=path.parent) as folder:
            new, old = Path(folder, path.name), Path(folder, "old")
            yield new
            if path.is_dir():  # the system replaces files, but no folders
                os.rename(path, old)
            try:
                os.replace(new, path)
            except BaseException:
                if old.exists():
                    os.rename(old, path)
                raise
            shutil.rmtree(old, ignore_errors=True)
    except OSError as error:
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error
