"""SYSTEM 3 as a file."""

import warnings
from typing import Literal

import numpy as np
import tomli_w
from pydantic import Field

from sato.connectivity import Connectivity
from sato.connectivity.distance import obstacle_distances
from sato.connectivity.kernel import CommandLimits
from sato.connectivity.obstacles import Obstacles
from sato.former.connectivity_start import check_start
from sato.former.connectivity_tables import (
    AnyPlant,
    Camera,
    Defence,
    Distance,
    Driven,
    Duration,
    Estimator,
    Messages,
    Most,
    Noise,
    Robots,
    Turning,
)
from sato.former.connectivity_world import (
    AnyObstacle,
    AnyStick,
    Lost,
    Scatter,
    ToWaypoints,
    mourned,
    placed,
    scattered,
)
from sato.former.file import ScenarioFile
from sato.former.refusal import Refusal, refused_at

SAFE = 2.5e-3  # way flown between two exchanges of power_pi up to which none of 50 runs broke [m]


class ConnectivityFile(ScenarioFile):
    """Robots that follow a leader and must not lose each other, as it stands in a file."""

    system: Literal["connectivity"]
    swarm: Robots = Robots()
    camera: Camera = Camera()
    potential: Defence = Defence()
    repulsion: Distance = Distance()
    tracking: Turning = Turning()
    limits: Most = Most()
    link: Messages = Messages()
    estimator: Estimator = Estimator()
    plant: AnyPlant = Driven(kind="kinematic")
    noise: Noise = Noise()
    stick: AnyStick = ToWaypoints(kind="waypoints")
    obstacles: Scatter = Scatter()
    obstacle: list[AnyObstacle] = Field(default=[])
    death: list[Lost] = Field(default=[])
    run: Duration = Duration()

    def build(self, rng: np.random.Generator) -> Connectivity:
        """The mission. Drawn are the start, beliefs, waypoints, obstacles and losses, in turn."""
        agents, step = self.swarm.agents, self.run.step_s
        with self.building():
            with refused_at("camera"):
                sight = self.camera.sight
            with refused_at("potential"):
                potential = self.potential.potential
            with refused_at("repulsion"):
                repulsion = self.repulsion.repulsion
            with refused_at("tracking"):
                tracking = self.tracking.tracking(step)
            with refused_at("link"):
                link = self.link.link(step)
            with refused_at("estimator"):
                power = self.estimator.power(agents, step)
            with refused_at("swarm.start"):
                posted = self.swarm.start.posted(agents, sight, rng)
                check_start(posted, sight, potential.lambda2_min, repulsion.min_distance)
            error = self.swarm.yaw_error_rad
            off = rng.uniform(-error, error, (agents, agents))
            with refused_at("stick"):
                stick = self.stick.stick(posted.position[0], rng)
            with refused_at("obstacle"):
                standing = placed(self.obstacle)
                _check_clear(standing, posted.position, repulsion.min_distance)
            with refused_at("obstacles"):
                drawn = scattered(
                    self.obstacles, posted.position, stick.waypoints, repulsion.min_distance, rng
                )
            with refused_at("death"):
                deaths = mourned(self.death, agents, self.run.duration_s, rng)
            return Connectivity(
                start=posted.position,
                start_yaw=posted.yaw,
                start_yaw_estimate=posted.yaw - posted.yaw[:, None] + off,
                stick=stick,
                duration=self.run.duration_s,
                step=step,
                camera=sight,
                range_only=self.camera.blind,
                potential=potential,
                repulsion=repulsion,
                tracking=tracking,
                limits=CommandLimits(self.limits.speed_m_s, self.limits.turn_rad_s),
                link=link,
                estimator=self.estimator.kind,
                power_iteration=power,
                plant=self.plant.plant,
                obstacles=standing._replace(spheres=np.vstack([standing.spheres, drawn])),
                camera_noise=self.noise.camera_m,
                occlusion=self.camera.occlusion,
                body_radius=self.camera.body_m,
                losses=deaths,
            )

    def warn(self, mission: Connectivity) -> None:
        """Warn of a leader that outruns the rest, and of an estimator that cannot follow."""
        most, asked = mission.limits.speed, mission.stick.speed
        if asked >= most:
            warnings.warn(
                f"the stick asks for {asked:g} m/s, and limits.speed_m_s = {most:g} is all that "
                "the robots answer it with: at 5 and 3 m/s nobody was lost in 20 flights, but the "
                "leader came within 0.92 m of an obstacle, of which 1 m is to be kept; "
                f"{2 / 3 * most:.3g} m/s would do",
                stacklevel=2,
            )
        between = most * mission.power_iteration.exchange_period
        if mission.estimator == "power_pi" and between > SAFE:
            warnings.warn(
                f"robots go {1e3 * between:.3g} mm from one exchange of power_pi to the next, and "
                f"beyond {1e3 * SAFE:g} mm it was seen to lose the swarm; limits.speed_m_s = "
                f"{SAFE / mission.power_iteration.exchange_period:.3g} would do",
                stacklevel=2,
            )

    def to_toml(self) -> str:
        """The whole scenario; a recorded stick is listed."""
        with self.building(), refused_at("stick"):
            stick = self.stick.portable()
        alone = self.model_copy(update={"stick": stick})
        return tomli_w.dumps(alone.model_dump(exclude_none=True))


def _check_clear(obstacles: Obstacles, start: np.ndarray, nearest: float) -> None:
    if obstacles.total == 0:
        return
    away = obstacle_distances(start, obstacles)
    robot, which = np.unravel_index(int(away.argmin()), away.shape)
    least = float(away[robot, which])
    if least <= nearest:
        where = "inside of it" if least < 0 else f"{least:.3g} m from it"
        names = ("sphere", "box", "plane")
        counts = np.cumsum([len(kind) for kind in obstacles])
        kind = int(np.searchsorted(counts, which, side="right"))
        number = int(which) - (int(counts[kind - 1]) if kind else 0)
        raise Refusal(
            "",
            f"robot {robot} starts {where}, of {names[kind]} {number}, and repulsion.nearest_m = "
            f"{nearest:g} is where an obstacle pushes without limit; move one of them",
        )
