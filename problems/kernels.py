"""Compiled functions, kept between runs: beside their source, at home, or in a temporary folder."""

import os
import tempfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from stat import S_IMODE
from typing import Any

import numba


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Return a decorator that compiles a function when it is first called, and keeps the result."""
    decorate = numba.njit(cache=True, **options)

    def compile_kept(function: Callable[..., Any]) -> Any:
        try:
            return decorate(function)
        except RuntimeError:  # neither the source's folder nor the user's can be written to
            numba.config.CACHE_DIR = _find_cache()
            return decorate(function)

    return compile_kept


def _find_cache() -> str:
    """Return a folder of the user alone, since what is in it is run."""
    folder = Path(tempfile.gettempdir(), f"sato-kernels-{os.getuid()}")
    with suppress(FileExistsError):  # a file, or a link, of whomever
        folder.mkdir(mode=0o700)
    status = folder.lstat()
    is_private = status.st_uid == os.getuid() and S_IMODE(status.st_mode) == 0o700
    return str(folder) if folder.is_dir() and is_private else tempfile.mkdtemp()
