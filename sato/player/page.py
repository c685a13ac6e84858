"""Page of the player: code, style and data in one HTML file."""

import re
from base64 import b64encode
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

from dynamics.doors import checked
from sato.atomic import replace_atomically
from sato.player.encode import encode_scene
from sato.record import drawn_mark
from sato.scenario.errors import InputError
from sato.scene import SwarmScene
from sato.terminal import as_html, as_line

SCRIPTS = ("data.js", "scene.js", "controls.js", "player.js")
DEFAULT_NAME = "player.html"  # in the folder of a run


@checked
def write_player(scene: SwarmScene, attributes: Mapping[str, Any], path: Path) -> Path:
    """Write a run as one HTML file, which plays it in a browser without a network.

    Args:
        scene: Scene of the run.
        attributes: Attributes of the run.
        path: File to write; its folder is made if it is missing.

    Returns:
        The path.

    Raises:
        InputError: The path is that of a folder.
        OSError: The file cannot be written; one that was there is kept.
    """
    if path.is_dir():
        raise InputError("", f"{path}: is a folder, and the player is one file")
    title = as_line(f"{attributes['name']}, seed {attributes['seed']}")
    about = {name: as_line(str(attributes[name])) for name in ("system", "version")}
    parts = {
        "TITLE": as_html(title),
        "VERDICT": as_html(scene.verdict),
        "STYLE": _read("player.css"),
        "THREE": _read("three.min.js"),
        "DATA": b64encode(encode_scene(scene, about | {"title": title})).decode(),
        "PLAYER": "\n".join(map(_read, SCRIPTS)),
    }
    page = re.sub("@([A-Z]+)@", lambda mark: parts[mark[1]], _read("player.html"))
    page += f"<!-- {as_html(drawn_mark(attributes.get('digest', '')))} -->\n"
    with replace_atomically(path) as new:
        new.write_text(page, encoding="utf-8")
    return path


def _read(name: str) -> str:
    return files("sato.player").joinpath(name).read_text(encoding="utf-8")
