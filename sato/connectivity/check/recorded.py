"""Run of a connectivity mission as recorded, and quantities that follow from it."""

from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from dynamics.kinematic import KinematicVehicle
from dynamics.vehicle import VehicleState, rotate_by_yaw
from sato.check.common import common_summary, find_closest_approach, incomplete_reason
from sato.connectivity.loop import advance_vehicles
from sato.connectivity.mission import Connectivity
from sato.connectivity.obstacles import min_obstacle_distance
from sato.connectivity.sensors import CameraViews, compute_views
from sato.record import RunRecord

MAX_BATCH = 1_000_000  # pairs, with what may hide one from the other, of one computation


class ConnectivityRecord(RunRecord[Connectivity, Any, None]):
    """Frames of a run, with time as their leading axis, and its drawn mission."""

    @cached_property
