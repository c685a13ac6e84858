"""Encoding of a scene for the player: arrays of 16-bit integers, deflated.

The data are the length of a JSON header, the header, and all arrays one after the other. An
array is rounded to multiples of its scale, counted from a first one; 65535 is NaN. Differences
of differences along its first axis, and then all low bytes before all high ones, deflate well.
"""

import json
import struct
import zlib
from typing import Any

import numpy as np
from jaxtyping import Shaped
from numpy import ndarray as Array

from sato.scene import Links, SwarmScene, pad_to_space
from sato.terminal import as_line

MISSING = 65535
LARGEST = 65534  # of the integers that stand for numbers
MAX_STATES = 1_000_000  # states that are written; of more, every second or third instant, …
LISTED_AGENTS = 12  # of an event


class ArrayWriter:
    """Arrays as they are written, and what the header says of each."""

    def __init__(self) -> None:
        self.parts: list[bytes] = []
        self.size = 0  # [byte]

    def add(self, values: Shaped[Array, "..."]) -> dict[str, Any]:
        """Write numbers; return where they start, shape, scale, first and largest error."""
        values = np.asarray(values, dtype=float)
        is_finite = np.isfinite(values)
        low = float(values.min(initial=np.inf, where=is_finite)) if is_finite.any() else 0.0
        high = float(values.max(initial=-np.inf, where=is_finite)) if is_finite.any() else 0.0
        is_whole = high - low <= LARGEST and not (values[is_finite] % 1).any()
        scale = 1.0 if is_whole else (high - low) / (LARGEST - 1) or abs(low)
        first = int(np.floor(low / scale))  # zero is exact
        codes = np.where(is_finite, np.round(values / scale) - first, MISSING)
        wrapped = codes.astype(np.int64).reshape(len(codes), codes.size // max(len(codes), 1))
        for _ in range(2):
            wrapped = np.diff(wrapped, axis=0, prepend=np.zeros_like(wrapped[:1]))
        flat = wrapped.astype(np.uint16).T.ravel()  # the instants of one number side by side
        self.parts += [(flat & 255).astype(np.uint8).tobytes(), (flat >> 8).astype("u1").tobytes()]
        about = {"start": self.size, "shape": list(values.shape), "scale": scale, "first": first}
        self.size += 2 * len(flat)
        return about | {"error": 0.0 if is_whole else scale / 2}


def encode_scene(scene: SwarmScene, about: dict[str, Any]) -> bytes:
    """Encode a scene with all that the page says about the run."""
    instants, agents = scene.status.shape
    every = int(np.ceil(instants * agents / MAX_STATES))
    k, writer = np.arange(0, instants, every), ArrayWriter()
    low, high = map(pad_to_space, scene.bounds)
    targets = scene.targets
    if len(targets.position) == instants > 1:
        targets = targets._replace(position=targets.position[k], stage=np.arange(len(k)))
    else:
        targets = targets._replace(stage=targets.stage[k])
    header = about | {
        "every": every,
        "time": [_round(t) for t in scene.time[k]],
        "bounds": [low.tolist(), high.tolist()],
        "flat": scene.is_flat,
        "planar": scene.position.shape[2] == 2,
        "viewpoint": scene.viewpoint._asdict(),
        "diameter": scene.diameter.tolist(),
        "position": writer.add(pad_to_space(scene.position[k])),
        "velocity": writer.add(pad_to_space(scene.velocity[k])),
        "status": writer.add(scene.status[k]),
        "targets": {
            "name": targets.name,
            "position": writer.add(pad_to_space(targets.position)),
            "stage": targets.stage.tolist(),
            "held": writer.add(targets.held[k]),
        },
        "links": _encode_links(scene.links, every, writer),
        "colorings": [
            one._asdict() | {"values": writer.add(one.values[k])} for one in scene.colorings
        ],
        "series": [one._asdict() | {"values": writer.add(one.values[k])} for one in scene.series],
        "stages": [(_round(start), as_line(name)) for start, name in scene.stages],
        "events": _gather_events(scene),
        "obstacles": [
            {
                "vertices": pad_to_space(hull.vertices).tolist(),
                "triangles": hull.triangles.tolist(),
                "velocity": pad_to_space(hull.velocity).tolist(),
            }
            for hull in scene.obstacles
        ],
    }
    text = json.dumps(header, allow_nan=False, separators=(",", ":")).encode()
    return zlib.compress(b"".join([struct.pack("<I", len(text)), text, *writer.parts]), 9)


def _encode_links(links: Links, every: int, writer: ArrayWriter) -> dict[str, Any]:
    found: dict[str, Any] = {"name": links.name, "radius": links.radius}
    if links.radius is None:
        # The last pairs until a written instant are those that are shown at it.
        last = {-(-first // every): pairs for first, pairs in links.listed}
        found["first"], found["count"] = list(last), [len(pairs) for pairs in last.values()]
        found["pairs"] = writer.add(np.concatenate([p.reshape(-1) for p in last.values()]))
    return found


def _gather_events(scene: SwarmScene) -> list[dict[str, Any]]:
    """Gather events of one kind and time; the first few of their agents are listed."""
    gathered: dict[tuple[str, float], list[int]] = {}
    broken = [{**each._asdict(), "kind": f"broken: {each.name}"} for each in scene.broken]
    for event in (*scene.events, *broken):
        key = (as_line(str(event["kind"])), _round(event["time"]))
        gathered.setdefault(key, []).extend(map(int, event["agents"]))
    return [
        {"kind": kind, "time": time, "agents": agents[:LISTED_AGENTS], "count": len(agents)}
        for (kind, time), agents in gathered.items()
    ]


def _round(time: float) -> float:
    # Events are at instants, also after the rounding.
    return round(float(time), 6)
