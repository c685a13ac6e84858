"""Files that anybody may have made: what is opened, and how much memory they may take."""

import os
from pathlib import Path
from stat import S_ISREG

from sato.scenario.errors import InputError, format_value

LIMIT = "SATO_MAX_MB"  # environment variable by which a user raises the limit
DEFAULT_LIMIT = 256  # [MB]
PARSED_TEXT = 30  # times the size of a text that its objects take
UNPACKING = 8  # times the size of a file that its contents may take, if that is more


def check_regular(path: Path) -> int:
    """Return the size of a file [byte]; an `InputError` refuses devices, pipes and folders."""
    status = path.stat()
    if not S_ISREG(status.st_mode):
        raise InputError("", f"{path}: is no regular file")
    return status.st_size


def check_no_link(path: Path, place: str) -> None:
    """Refuse a link inside a folder that anybody may have made."""
    if path.is_symlink():
        raise InputError("", f"{path}: is a link, and none is followed in {place}")


def check_size(name: object, size: float, packed: float = 0.0) -> None:
    """Refuse contents that take too much memory [byte], also for the size of their file [byte]."""
    if size > max(_read_limit(), UNPACKING * packed):
        needed = f"unpacks to {size / 1e6:,.0f} MB"
        cure = f"with {LIMIT}={-(-size // 1_000_000):.0f} in the environment it is read"
        raise InputError("", f"{name}: {needed}, more than a file may; {cure}")


def check_text(name: object, size: int) -> None:
    """Refuse a text [byte] whose parts take too much memory."""
    check_size(name, PARSED_TEXT * size)


def read_text(path: Path) -> str:
    """Read a regular file of UTF-8 text, with or without a mark of its byte order."""
    check_text(path, check_regular(path))
    return path.read_text(encoding="utf-8-sig")


def _read_limit() -> float:
    text = os.environ.get(LIMIT, str(DEFAULT_LIMIT))
    if not (text.isascii() and text.isdecimal()):
        raise InputError(LIMIT, f"must be a whole number of MB, got {format_value(text)}")
    return 1e6 * int(text)
