"""The variables of a run file: their axes, units and meaning."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from numpy import ndarray as Array

if TYPE_CHECKING:  # xarray takes a second to load
    import xarray

# Of the chief's orbit, as `dynamics.orbit.Orbit` has them.
ELEMENTS = ("r", "v_x", "h", "node", "inclination", "latitude")

# Name: its axes, unit and meaning. An entry without agents counts for the whole swarm.
MEANING: dict[str, tuple[tuple[str, ...], str, str]] = {
    "time": (("time",), "s", "time since the start"),
    "control_instant": (("time",), "1", "whether a control is commanded at this time"),
    "position": (("time", "agent", "axis"), "m", "true position"),
    "velocity": (("time", "agent", "axis"), "m/s", "true velocity"),
    "alive": (("time", "agent"), "1", "whether the agent takes part"),
    "component": (("time", "agent"), "1", "connected component of the network, -1 not alive"),
    "event": (("event",), "1", "what happened, as JSON with time and agents"),
    "control": (("time", "agent", "axis"), "m/s2", "commanded control, held to the next instant"),
    "applied_control": (("time", "agent", "axis"), "m/s2", "control with thrust errors"),
    "measured_position": (("time", "agent", "axis"), "m", "position as the agent believes it"),
    "measured_velocity": (("time", "agent", "axis"), "m/s", "velocity as the agent believes it"),
    "leg": (("time",), "1", "leg under way"),
    "target": (("time", "agent"), "1", "index of the target that the agent holds, -1 none"),
    "believed": (("time", "agent"), "1", "number of targets that the agent bids on"),
    "target_position": (("leg", "target", "axis"), "m", "position of each target"),
    "target_velocity": (("leg", "target", "axis"), "m/s", "velocity of each target"),
    "targets_believed": (("leg", "agent"), "1", "believed at the end of the leg, -1 none"),
    "element": (("element",), "1", "name of the chief's element"),
    "chief": (
        ("time", "element"),
        "m, m/s, m2/s, rad, rad, rad",
        "osculating orbit of the chief: radius, radial speed, angular momentum, right ascension "
        "of the ascending node, inclination, argument of latitude",
    ),
}
MAY_LACK = {"measured_position", "measured_velocity", "believed", "element", "chief"}


def dataset(variables: Mapping[str, Array], attributes: dict[str, Any]) -> "xarray.Dataset":
    """Variables with their axes, units and meaning."""
    import xarray

    arrays = {}
    for name, values in variables.items():
        dimensions, unit, meaning = MEANING[name]
        arrays[name] = (dimensions, values, {"units": unit, "long_name": meaning})
    return xarray.Dataset(arrays, attrs=attributes)
