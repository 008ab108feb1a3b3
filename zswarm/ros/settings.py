"""Settings of ``turtlebot-exit-ros``: those of turtlebot-exit, and how its ROS simulation is reached."""

from typing import Annotated, Literal

from msgspec import Meta

from zswarm.ros.graph import LinkKind
from zswarm.sims import turtlebot_exit

PROFILES: dict[LinkKind, str] = {"rospy": "stageros", "rclpy": "stage_ros2", "zenoh": "stage_ros2"}


class Settings(turtlebot_exit.Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of ``[problem.settings]``."""

    link: Annotated[
        LinkKind, Meta(description="zenoh: ROS 2 as rmw_zenoh speaks it, no ROS installed here; rclpy: ROS 2; rospy: ROS 1")
    ] = "zenoh"
    profile: Annotated[
        str, Meta(description="names of topics: a bundled profile or FILE.toml; empty: stageros for rospy, else stage_ros2")
    ] = ""
    launch: Annotated[
        Literal["own", "running"],
        Meta(description="own: each slot starts zswarm's simulation node; running: one that runs, at master, domain or connect"),
    ] = "own"
    mode: Annotated[
        Literal["lock-step", "free-running"],
        Meta(description="lock-step: the simulation waits for the robots; free-running: it does not, results are not repeatable"),
    ] = "lock-step"
    rate: Annotated[
        float, Meta(ge=1e-3, le=1e3, description="own and free-running: how many times as fast as the wall's clock it runs")
    ] = 1.0
    deadline_s: Annotated[float, Meta(ge=0.1, le=1e5, description="s in which the simulation must answer")] = 10.0
    master: Annotated[str, Meta(description="running, rospy: URI of the master; empty: as ROS_MASTER_URI says")] = ""
    domain: Annotated[int, Meta(ge=0, le=232, description="running, rclpy and zenoh: ROS domain")] = 0
    connect: Annotated[tuple[str, ...], Meta(description="running, zenoh: endpoints to dial, such as tcp/127.0.0.1:7447")] = ()

    @property
    def profile_or_default(self) -> str:
        """The profile's name, or that of what the link mostly speaks with."""
        return self.profile or PROFILES[self.link]
