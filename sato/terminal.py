"""Text on terminals and in pages: no character of a file or a message commands them."""

import codecs
import re
import sys
from html import escape
from unicodedata import name, normalize

import typer

# Controls but tab and newline, marks of direction, tags, halves of a pair, no characters.
_COMMANDS = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200b-\u200f\u2028-\u202e\u2060-\u206f\ud800-\udfff\ufeff]"
    "|[\ufff9-\ufffb\ufffe\uffff\U000e0000-\U000e0fff]"
)
_ASCII = {"λ": "lambda", "−": "-", "–": "-", "≤": "<=", "≥": ">=", "°": " deg", "·": "*", "×": "x"}
_ASCII |= {"²": "^2", "³": "^3", "⁵": "^5", "’": "'", "‘": "'", "“": '"', "”": '"', "→": "->"}
_ASCII["±"] = "+-"
STAND_IN = "sato.ascii"  # name of the error handler


def as_plain(text: str) -> str:
    """Return text with its control characters spelled out, as those of terminals by ESC are."""
    return _COMMANDS.sub(lambda match: match[0].encode("unicode_escape").decode(), text)


def as_line(text: str) -> str:
    """Return text as one line without control characters."""
    return as_plain(" ".join(text.split()))


def as_html(text: str) -> str:
    """Return text for a page, in which it is no markup."""
    return escape(as_plain(text))


def echo(text: str, err: bool = False, nl: bool = True) -> None:
    """Print text as it is, whatever it contains."""
    typer.echo(as_plain(text), err=err, nl=nl)


def use_ascii_where_needed() -> None:
    """Let ASCII stand in for characters that the encoding of the output does not have."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors=STAND_IN)


def _stand_in(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return "".join(map(_spell, error.object[error.start : error.end])), error.end


def _spell(letter: str) -> str:
    if letter in _ASCII:
        return _ASCII[letter]
    if plain := normalize("NFKD", letter).encode("ascii", "ignore").decode():
        return plain
    known = name(letter, "")
    if known.startswith("GREEK "):
        spelled = known.rpartition(" ")[2]
        return spelled.capitalize() if "CAPITAL" in known else spelled.lower()
    return "?"


codecs.register_error(STAND_IN, _stand_in)
