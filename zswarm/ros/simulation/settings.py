"""Settings of ``turtlebot-exit-ros``: those of turtlebot-exit, and how to reach ROS."""

from typing import Annotated, Literal

from zswarm.config.meta import about
from zswarm.plugins import manifests
from zswarm.ros.link.graph import LinkKind
from zswarm.sims import turtlebot_exit

OWN = "own"
PROFILES: dict[LinkKind, str] = {
    "rospy": "stageros",
    "rclpy": "stage_ros2",
    "zenoh": "stage_ros2",
}
LINK = (
    'with `simulation = "own"`: zenoh: ROS 2 by the protocol of rmw_zenoh, needs no ROS '
    "installation; rclpy: ROS 2; rospy: ROS 1"
)
PROFILE = 'with `simulation = "own"`: a bundled profile; empty: stageros for rospy, else stage_ros2'
SIMULATION = "own: each slot starts a simulation node; else the name of a server's file"
MODE = "lock-step: waits for the robots; free-running: does not wait, is not repeatable"
MISSED = "share of a trial's steps without a decision above which it is a fault"
REPEATABLE = (
    "with a server's file and lock-step: the same simulation on all servers, which are "
    "compared"
)
RATE = 'with `simulation = "own"` and free-running: speed as a multiple of real time'


class RosSettings(
    turtlebot_exit.TurtlebotExitSettings,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
):
    """Settings of ``[problem.settings]``."""

    link: Annotated[LinkKind, about(LINK)] = "zenoh"
    profile: Annotated[str, about(PROFILE, pattern=r"^[a-z0-9_-]*$")] = ""
    simulation: Annotated[
        str, about(SIMULATION, pattern=f"^{manifests.NAME.pattern}$")
    ] = OWN
    mode: Annotated[Literal["lock-step", "free-running"], about(MODE)] = "lock-step"
    rate: Annotated[float, about(RATE, ge=1e-3, le=1e3)] = 1.0
    deadline_s: Annotated[
        float, about("s for the simulation to answer", ge=0.1, le=1e5)
    ] = 10.0
    repeatable: Annotated[bool, about(REPEATABLE)] = False
    missed_limit: Annotated[float, about(MISSED, ge=0, le=1)] = 0.2

    def __post_init__(self) -> None:
        if self.simulation != OWN and (self.profile or self.link != "zenoh"):
            raise ValueError(
                f"simulation {self.simulation!r}: link and profile are those of the server's "
                "file; expected neither here"
            )
        if self.repeatable and (self.simulation == OWN or self.mode != "lock-step"):
            raise ValueError(
                "repeatable: expected the name of a server's file as simulation, and "
                'mode = "lock-step"; the slot\'s own simulation is repeatable in lock-step'
            )

    @property
    def profile_or_default(self) -> str:
        """The profile's name, or the default for the link, of a slot's own simulation."""
        return self.profile or PROFILES[self.link]
