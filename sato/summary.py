"""Summary of a run as text: labels with units, and numbers with the digits that they need."""

from collections.abc import Mapping
from typing import Any

LABELS = {  # of entries that end as if they had a unit, or are named differently in prose
    "fuel_per_agent_m_s": ("Δv per spacecraft", "m/s"),
    "bytes_per_vehicle_s": ("sent by each vehicle", "bytes/s"),
    "bytes_received_max": ("received by an agent, at most", "bytes"),
    "messages_received_max": ("received by an agent, at most", "messages"),
    "auction_rounds_max": ("auctions of an instant, at most", "rounds"),
}


def summary_rows(summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Format the entries of a summary that are not lists of parts, such as legs."""
    rows = []
    for name, value in summary.items():
        if is_parts(value):
            continue
        if isinstance(value, dict):
            rows += [(format_label(name, part), format_value(one)) for part, one in value.items()]
        else:
            radius = summary.get("collision_radius_m")
            radius = radius if isinstance(radius, float) else None
            limit = radius if name.startswith("min_separation") else None
            rows.append((format_label(name), format_value(value, limit)))
    return rows


def is_parts(value: object) -> bool:
    """Return True for a list of tables: the legs of a run."""
    return isinstance(value, list) and bool(value) and all(isinstance(p, dict) for p in value)


def format_label(name: str, part: str = "") -> str:
    """Format the name of an entry, with its unit."""
    label, unit = LABELS.get(name) or _split_unit(name)
    return ", ".join(text for text in (label, part, unit) if text)


def format_value(value: object, compared_to: float | None = None, digits: int = 4) -> str:
    """Format a value, with as many digits as tell it from the one that it is compared to."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        if compared_to is not None and compared_to != value:
            while digits < 16 and f"{value:.{digits}g}" == f"{compared_to:.{digits}g}":
                digits += 1
        return f"{value:.{digits}g}"
    if isinstance(value, list):
        return ", ".join(map(str, value)) or "none"
    return "" if value is None else str(value)


def _split_unit(name: str) -> tuple[str, str]:
    for ending, unit in (("_m_s", "m/s"), ("_m", "m"), ("_s", "s"), ("_mib", "MiB")):
        if name.endswith(ending):
            return name.removesuffix(ending).replace("_", " "), unit
    return name.replace("_", " "), ""
