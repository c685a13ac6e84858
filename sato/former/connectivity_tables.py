"""The tables of a connectivity scenario, each key with what it may be.

What is not said is as in Table I of [Bernard2023] and, where it says nothing, as we measured.
"""

from math import hypot
from typing import Annotated, Literal

from pydantic import Field, NonNegativeFloat, NonNegativeInt, PositiveFloat, PositiveInt

from dynamics.kinematic import KinematicVehicle
from dynamics.quadrotor import STANDARD_GRAVITY, Quadrotor
from problems.interaction_graph import Camera as CameraModel
from sato.connectivity.kernel import MAX_ROW_AGE, CommandLimits
from sato.connectivity.messages import CommunicationLink
from sato.connectivity.mission import Connectivity
from sato.connectivity.potential import Potential, Repulsion
from sato.connectivity.power_iteration import PowerIterationGains, default_gains, spectral_radius
from sato.connectivity.yaw_estimator import YawTracking
from sato.former.connectivity_start import AnyStart, Scattered
from sato.former.refusal import Refusal, listed
from sato.former.units import Table

_SIGHT, _POTENTIAL, _REPULSION = CameraModel(), Potential(), Repulsion()
_TRACKING, _LIMITS, _LINK = YawTracking(), CommandLimits(), CommunicationLink()
_KINEMATIC, _QUADROTOR = KinematicVehicle(), Quadrotor()
OLD = MAX_ROW_AGE / 5  # that a message may be: some hops, and then its rows are forgotten [s]
GAINS = {  # of power_pi
    "deflate": "deflation_gain",
    "iterate": "iteration_gain",
    "normalise": "normalization_gain",
    "follow": "filter_gain",
    "agree": "proportional_gain",
    "settle": "integral_gain",
}


class Robots(Table):
    """Who flies, from where, and how well they know at first how others are turned."""

    agents: Annotated[int, Field(ge=2)] = 6
    start: AnyStart = Scattered(kind="random")
    yaw_error_rad: NonNegativeFloat = 0.5  # of the first beliefs, drawn from ± that much


class Camera(Table):
    """What a camera sees; `blind` leaves the field of view out of the weights."""

    d_min_m: NonNegativeFloat = _SIGHT.d_min
    d_near_m: PositiveFloat = _SIGHT.d_near
    d_far_m: PositiveFloat = _SIGHT.d_far
    d_max_m: PositiveFloat = _SIGHT.d_max
    a_min: Annotated[float, Field(ge=-1)] = _SIGHT.a_min
    a_max: Annotated[float, Field(gt=-1)] = _SIGHT.a_max
    axis: list[float] = Field(default=list(_SIGHT.optical_axis))
    blind: bool = False
    occlusion: bool = False
    body_m: PositiveFloat = Connectivity.body_radius  # radius of who stands in the line of sight

    @property
    def sight(self) -> CameraModel:
        """As the robots work with it.

        Raises:
            Refusal: Distances or cosines are not in order, or the axis is none.
        """
        if not self.d_near_m < self.d_far_m:
            raise Refusal(
                "d_near_m",
                f"{self.d_near_m:g} is not less than d_far_m = {self.d_far_m:g}, so at no distance "
                f"is all seen; {self.d_far_m / 2:g} would do",
            )
        if not self.d_min_m < self.d_near_m:
            raise Refusal(
                "d_min_m",
                f"{self.d_min_m:g} is not less than d_near_m = {self.d_near_m:g}; "
                f"{self.d_near_m / 3:g} would do",
            )
        if not self.d_far_m < self.d_max_m:
            raise Refusal(
                "d_max_m",
                f"{self.d_max_m:g} is not more than d_far_m = {self.d_far_m:g}; "
                f"{self.d_far_m + 2:g} would do",
            )
        if not self.a_min < self.a_max <= 1:
            raise Refusal(
                "a_min",
                f"{self.a_min:g} and a_max = {self.a_max:g} are cosines off the optical axis, the "
                "first less than the second, and that 1 at most; 0.4 and 0.95 would do",
            )
        size = hypot(*self.axis)
        if len(self.axis) != 3 or not 1e-6 < size < 1e6:
            raise Refusal("axis", "needs 3 coordinates, the length not 0; [1, 1, 0] would do")
        x, y, z = (a / size for a in self.axis)
        return CameraModel(
            self.d_min_m, self.d_near_m, self.d_far_m, self.d_max_m, self.a_min, self.a_max,
            (x, y, z),
        )  # fmt: skip


class Defence(Table):
    """How hard connectivity is defended; between the two λ₂."""

    lambda2_min: NonNegativeFloat = _POTENTIAL.lambda2_min
    lambda2_max: PositiveFloat = _POTENTIAL.lambda2_max
    strength: NonNegativeFloat = _POTENTIAL.strength

    @property
    def potential(self) -> Potential:
        """As the robots work with it.

        Raises:
            Refusal: The limits are not in order.
        """
        _in_order(self, "lambda2_min", "lambda2_max", 300)
        return Potential(self.lambda2_min, self.lambda2_max, self.strength)


class Distance(Table):
    """How hard robots and obstacles push, and from where on."""

    nearest_m: PositiveFloat = _REPULSION.min_distance
    farthest_m: PositiveFloat = _REPULSION.max_distance
    strength: NonNegativeFloat = _REPULSION.strength

    @property
    def repulsion(self) -> Repulsion:
        """As the robots work with it.

        Raises:
            Refusal: The distances are not in order.
        """
        _in_order(self, "nearest_m", "farthest_m", 3)
        return Repulsion(self.nearest_m, self.farthest_m, self.strength)


class Turning(Table):
    """How robots keep track of how others are turned; gains in 1/s."""

    k1: PositiveFloat = _TRACKING.k1
    k2: NonNegativeFloat = _TRACKING.k2
    k3: NonNegativeFloat = _TRACKING.k3
    slow_m_s: NonNegativeFloat = _TRACKING.min_speed
    fast_m_s: PositiveFloat = _TRACKING.max_speed
    closure: NonNegativeFloat = _TRACKING.closure_gain
    printed: bool = _TRACKING.as_printed

    def tracking(self, step: float) -> YawTracking:
        """As the robots work with it.

        Args:
            step: Of control [s].

        Raises:
            Refusal: The speeds are not in order, or a correction overshoots.
        """
        _in_order(self, "slow_m_s", "fast_m_s", 3)
        # In discrete time an error is left with 1 − gain × step of it.
        for name, gain in (("k2", self.k2 + self.closure), ("k3", self.k3)):
            if gain * step >= 2:
                also = f", with closure = {self.closure:g}," if name == "k2" else ""
                raise Refusal(
                    name,
                    f"{getattr(self, name):g}{also} does not settle at a control step of {step:g} "
                    f"s: an error becomes {1 - gain * step:.3g} times as large in each; gains of "
                    f"{0.2 / step:.3g} would do",
                )
        return YawTracking(
            self.k1, self.k2, self.k3, self.slow_m_s, self.fast_m_s, self.closure, self.printed
        )


class Most(Table):
    """What a robot asks of itself at most."""

    speed_m_s: PositiveFloat = _LIMITS.speed
    turn_rad_s: PositiveFloat = _LIMITS.yaw_rate


class Messages(Table):
    """How messages travel."""

    every: PositiveInt = _LINK.period_steps  # control steps between two
    late: NonNegativeInt = _LINK.delay_messages  # how many messages later one arrives
    loss: Annotated[float, Field(ge=0, lt=1)] = _LINK.loss_probability

    def link(self, step: float) -> CommunicationLink:
        """As messages travel.

        Args:
            step: Of control [s].

        Raises:
            Refusal: What they tell is too old when it is used.
        """
        oldest = (self.late + 1) * self.every * step
        if oldest > OLD * (1 + 1e-9):
            most = max(1, int(OLD / step))
            raise Refusal(
                "late" if self.late else "every",
                f"messages are {oldest:.3g} s old before the next one comes, and may be {OLD:g} s: "
                "rows of the adjacency are passed on some times before they are forgotten, after "
                f"{MAX_ROW_AGE:g} s; every = 1 and late = {most - 1} would do",
            )
        return CommunicationLink(self.every, self.late, self.loss)


class Estimator(Table):
    """Who tells λ₂. The gains, in 1/s, and the exchange are of "power_pi" alone."""

    kind: Literal["flood", "exact", "power_pi"] = "flood"
    exchange_s: PositiveFloat = PowerIterationGains().exchange_period
    deflate: PositiveFloat | None = None
    iterate: PositiveFloat | None = None
    normalise: PositiveFloat | None = None
    follow: PositiveFloat | None = None
    agree: PositiveFloat | None = None
    settle: PositiveFloat | None = None

    def power(self, agents: int, step: float) -> PowerIterationGains:
        """The gains; those that are not said fit the exchange and the number of robots.

        Raises:
            Refusal: They do not settle, or exchanges do not fall on control steps.
        """
        said = self.model_dump(exclude={"kind", "exchange_s"}, exclude_none=True)
        power = default_gains(self.exchange_s, agents)._replace(
            **{GAINS[key]: value for key, value in said.items()}
        )
        if self.kind != "power_pi":
            return power
        whole = max(1, round(step / self.exchange_s))
        if abs(step - whole * self.exchange_s) > 1e-6 * step:
            raise Refusal(
                "exchange_s",
                f"{self.exchange_s:g} does not divide the control step of {step:g} s; "
                f"{step / whole:.6g} would do",
            )
        radius, good = spectral_radius(power, agents), default_gains(self.exchange_s, agents)
        if radius >= 1:
            raise Refusal(
                "",
                f"with these gains the iteration of {agents} robots, or its consensus, does not "
                f"settle at an exchange every {self.exchange_s:g} s: the spectral radius is "
                f"{radius:.4g}, and must be below 1; "
                + listed(
                    (f"{key} = {getattr(good, name):.4g}" for key, name in GAINS.items()), "and"
                )
                + " would do, and are taken where nothing is said",
            )
        return power


class Driven(Table):
    """Robots that obey."""

    kind: Literal["kinematic"]
    lag_s: NonNegativeFloat = _KINEMATIC.time_constant
    noise: NonNegativeFloat = _KINEMATIC.noise_std  # of each velocity in each step [m/s, rad/s]

    @property
    def plant(self) -> KinematicVehicle:
        """As it flies."""
        return KinematicVehicle(self.lag_s, self.noise)


class Flown(Table):
    """Quadrotors, whose cameras tilt with them."""

    kind: Literal["quadrotor"]
    response_s: PositiveFloat = _QUADROTOR.velocity_time_constant
    attitude_s: PositiveFloat = _QUADROTOR.attitude_time_constant
    tilt_rad: Annotated[float, Field(gt=0, lt=1.5)] = _QUADROTOR.max_tilt
    climb_m_s2: Annotated[float, Field(gt=0, lt=STANDARD_GRAVITY)] = (
        _QUADROTOR.max_vertical_acceleration
    )

    @property
    def plant(self) -> Quadrotor:
        """As it flies."""
        return Quadrotor(self.response_s, self.attitude_s, self.tilt_rad, self.climb_m_s2)


AnyPlant = Annotated[Driven | Flown, Field(discriminator="kind")]


class Noise(Table):
    """What cameras measure wrongly."""

    camera_m: NonNegativeFloat = Connectivity.camera_noise  # standard deviation of each coordinate


class Duration(Table):
    """How long it is flown, and how often robots decide."""

    duration_s: PositiveFloat = Connectivity.duration
    step_s: PositiveFloat = Connectivity.step


def _in_order(table: Table, low: str, high: str, parts: int) -> None:
    # One key must be less than the other; so many parts of which would do.
    is_low, is_high = getattr(table, low), getattr(table, high)
    if not is_low < is_high:
        raise Refusal(
            low, f"{is_low:g} is not less than {high} = {is_high:g}; {is_high / parts:.3g} would do"
        )
