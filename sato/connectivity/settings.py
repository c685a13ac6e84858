"""Settings of a connectivity mission: action, repulsion, tracking, limits, messages, gains."""

from typing import Annotated, Literal, NamedTuple

from dynamics.doors import checked
from dynamics.units import AngularRate, Key, Length, Speed, Time
from sato.scenario.definition import LATER, NotNegative, Positive

MAX_ROW_AGE = 1.0  # age at which a row of the adjacency matrix is forgotten [s]
# Time for which a neighbor's last message is used; rows are relayed several times meanwhile [s].
MAX_MESSAGE_AGE = MAX_ROW_AGE / 5


@checked
class Potential(NamedTuple):
    """Potential V of λ₂ alone [Bernard2023, Fig. 2], or the sum of V(λ_k) over k ≥ 2."""

    lambda2_min: Annotated[float, NotNegative, "λ₂^min, at which the potential is infinite"] = 0.01
    lambda2_max: Annotated[float, Positive, "λ₂^max, from which on the potential is zero"] = 3.01
    strength: Annotated[float, NotNegative, "gain of the action that keeps λ₂ large"] = 0.1
    of: Annotated[
        Literal["spectrum", "lambda2"],
        "its eigenvalues: all, which is smooth where they meet, or λ₂ alone, as power_pi must",
    ] = LATER


@checked
class Repulsion(NamedTuple):
    """Repulsion of a point that the range sensor measures [Bernard2023, Sec. III-D]."""

    min_distance: Annotated[
        Length, Key("nearest"), Positive, "distance d_min^obs, at which repulsion is infinite"
    ] = 1.0
    max_distance: Annotated[
        Length, Key("farthest"), Positive, "distance d_max^obs, from which on repulsion is zero"
    ] = 3.5
    strength: Annotated[float, NotNegative, "gain of repulsion [1/s]"] = 0.5


@checked
class YawTracking(NamedTuple):
    """Gains and speeds of the estimator."""

    k1: Annotated[float, Positive, "gain of the velocity observer [1/s]"] = 10.0
    k2: Annotated[float, NotNegative, "gain of the correction by motion [1/s]"] = 10.0
    k3: Annotated[float, NotNegative, "gain of the correction by mutual bearings [1/s]"] = 10.0
    min_speed: Annotated[
        Speed, Key("slow"), NotNegative, "horizontal speed v_min below which motion is not used"
    ] = 0.1
    max_speed: Annotated[
        Speed, Key("fast"), Positive, "horizontal speed v_max above which motion counts fully"
    ] = 0.3
    closure_gain: Annotated[
        float, Key("closure"), NotNegative, "gain of the correction around triangles [1/s]"
    ] = 5.0
    as_printed: Annotated[
        bool, Key("printed"), "estimator as printed, without compensation of the observer's lag"
    ] = False


@checked
class CommandLimits(NamedTuple):
    """Limits of what a robot commands, beside the operator's command to the leader."""

    speed: Annotated[Speed, Positive, "largest speed"] = 3.0
    yaw_rate: Annotated[AngularRate, Key("turn"), Positive, "largest yaw rate"] = 1.5


Gain = Annotated[float, Positive]


@checked
class PowerIterationGains(NamedTuple):
    """Gains of the iteration and its consensus; those that are None fit the other numbers."""

    exchange_period: Annotated[
        Time, Key("exchange"), Positive, "time h between two exchanges with all neighbors"
    ] = 0.002
    deflation_gain: Annotated[Gain, Key("deflate"), "e₁, removes the mean [1/s]"] = LATER
    iteration_gain: Annotated[Gain, Key("iterate"), "e₂, draws to the eigenvector [1/s]"] = LATER
    normalization_gain: Annotated[Gain, Key("normalize"), "e₃, keeps the size [1/s]"] = LATER
    filter_gain: Annotated[Gain, Key("follow"), "g, input filter of the consensus [1/s]"] = LATER
    proportional_gain: Annotated[Gain, Key("agree"), "K_P of the consensus [1/s]"] = LATER
    integral_gain: Annotated[Gain, Key("settle"), "K_I of the consensus [1/s]"] = LATER


def complete_gains(given: PowerIterationGains, agents: int) -> PowerIterationGains:
    """Replace gains that are None by ones that suit the period and the number of agents."""
    h = given.exchange_period
    n = agents * h
    suited = PowerIterationGains(h, 0.05 / h, 0.006 * 6 / n, 0.05 / h, 0.2 / h, 1.7 / n, 1.2 / n)
    chosen = {name: gain for name, gain in given._asdict().items() if gain is not None}
    return suited._replace(**chosen)
