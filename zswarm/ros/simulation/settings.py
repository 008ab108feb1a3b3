"""Settings of ``turtlebot-exit-ros``: those of turtlebot-exit, and how to reach ROS."""

from typing import Annotated, Literal

from zswarm.config.meta import about
from zswarm.ros.link.graph import LinkKind
from zswarm.sims import turtlebot_exit

PROFILES: dict[LinkKind, str] = {
    "rospy": "stageros",
    "rclpy": "stage_ros2",
    "zenoh": "stage_ros2",
}
LINK = "zenoh: ROS 2 as rmw_zenoh speaks it, without ROS here; rclpy: ROS 2; rospy: ROS 1"
PROFILE = "a bundled profile or FILE.toml; empty: stageros for rospy, else stage_ros2"
LAUNCH = (
    "own: each slot starts a simulation node; running: one at master, domain or connect"
)
MODE = "lock-step: waits for the robots; free-running: does not wait, is not repeatable"
RATE = "own and free-running: speed as a multiple of real time"


class RosSettings(
    turtlebot_exit.TurtlebotExitSettings,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
):
    """Settings of ``[problem.settings]``."""

    link: Annotated[LinkKind, about(LINK)] = "zenoh"
    profile: Annotated[str, about(PROFILE)] = ""
    launch: Annotated[Literal["own", "running"], about(LAUNCH)] = "own"
    mode: Annotated[Literal["lock-step", "free-running"], about(MODE)] = "lock-step"
    rate: Annotated[float, about(RATE, ge=1e-3, le=1e3)] = 1.0
    deadline_s: Annotated[
        float, about("s for the simulation to answer", ge=0.1, le=1e5)
    ] = 10.0
    master: Annotated[str, about("running, rospy: master URI; empty: ROS_MASTER_URI")] = (
        ""
    )
    domain: Annotated[
        int, about("running, rclpy and zenoh: ROS domain", ge=0, le=232)
    ] = 0
    # msgspec copies the default.
    connect: Annotated[list[str], about("running, zenoh: endpoints to dial")] = []  # noqa: RUF012

    @property
    def profile_or_default(self) -> str:
        """The profile's name, or the default for the link."""
        return self.profile or PROFILES[self.link]
