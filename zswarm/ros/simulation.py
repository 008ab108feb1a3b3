"""A ROS simulation as a slot drives it: its own node, or one that runs; trials begin, velocities go out, readings come."""

import contextlib
import fcntl
import hashlib
import sys
import tempfile
import time
import weakref
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import msgspec
import numpy as np

from zswarm.errors import EvaluationError
from zswarm.ros import graph
from zswarm.ros.child import Child
from zswarm.ros.graph import Graph
from zswarm.ros.link import Link
from zswarm.ros.messages import Reset, Velocity
from zswarm.ros.profiles import Channel, Profile
from zswarm.ros.readings import Readings
from zswarm.ros.settings import Settings
from zswarm.sims import turtlebot_exit
from zswarm.sims.simulator import RobotInterface

NS = 1_000_000_000
READY_S = 30.0  # until both sides found each other
LISTENED_S = 0.2  # to a simulation that may be under way, before the first trial
FLOODED_S = 0.5  # spent at most on messages of a simulation that says more than can be taken
LOOKED_S = 0.2  # between two looks whether the node is there
SOON = 0.75  # of a step: a scan so much later than the last one is the next; free-running ones are not exact


class Simulation:
    """One at work, until it is closed or nobody knows it any more."""

    def __init__(self, settings: Settings, profile: Profile, interface: RobotInterface) -> None:
        """Start the node if it is the slot's own, and the link.

        Raises:
            ConfigError: ROS is not there, with what to install; the profile does not fit the link.
            EvaluationError: node or link ended or did not find each other in time; another slot drives the running one.
        """
        self._settings, self._profile = settings, profile
        self._robots, self._lock_step = settings.robots, settings.mode == "lock-step"
        self._step_ns = round(settings.step_s * NS)
        self.stamp_ns = 0
        pose: Channel = "odometry" if profile.ground_truth is None else "ground_truth"
        self._readings = Readings(interface, truth=pose == "ground_truth")
        used: list[Channel] = ["velocity", "scan", pose, "reset"]
        if not self._lock_step:
            used.append("clock")
        with contextlib.ExitStack() as opened:
            if settings.launch == "own":
                here = opened.enter_context(graph.private(settings.link))
                command = _node(settings, here.dialled(), f"scan,{pose}")
                self._node: Child | None = Child("the simulation node", command, here.environment(profile.distribution), {})
                opened.callback(self._node.close)
            else:
                here = Graph(
                    link=settings.link,
                    master=settings.master,
                    domain=settings.domain,
                    connect=settings.connect,
                    local=False,
                )
                self._node = None
                opened.enter_context(_alone_with(here))
            self._link = opened.enter_context(Link(here, profile, robots=self._robots, side="controllers", channels=used))
            self._link.ready(READY_S)
            self.close = weakref.finalize(self, opened.pop_all().close)

    def begin(self, seed: int, scans: np.ndarray, poses: np.ndarray) -> None:
        """Begin a trial; all robots' scans and poses are filled, see ``Readings.fill``.

        Raises:
            EvaluationError: the simulation does not answer.
        """
        if not self._lock_step:
            self._listen(LISTENED_S)
        before_ns = self._readings.clock_ns
        self._readings.forget()
        self._link.send([Reset(seed=seed)])
        due_ns = self._step_ns
        if self._profile.reset.service:  # its clock goes on
            due_ns = before_ns + 2 * self._step_ns
        elif not self._lock_step:
            self._wait_for_the_clock_to_go_back(before_ns)
        self._look(range(self._robots), due_ns, scans, poses)

    def drive(self, robots: Sequence[int], linear: np.ndarray, angular: np.ndarray) -> bool:
        """Publish what robots decided; whether the simulation's time had gone on since the scans that they decided by."""
        late = False
        if not self._lock_step:
            self._listen(0.0)
            late = self._readings.clock_ns > self.stamp_ns
        self._link.send(
            [Velocity(robot=robot, stamp_ns=self.stamp_ns, linear=linear[robot], angular=angular[robot]) for robot in robots]
        )
        return late

    def look(self, robots: Sequence[int], scans: np.ndarray, poses: np.ndarray) -> int:
        """Wait for the next readings of robots, which are filled; how many steps have passed.

        Raises:
            EvaluationError: they do not come.
        """
        before_ns = self.stamp_ns
        wait_ns = self._step_ns if self._lock_step else round(SOON * self._step_ns)
        self._look(robots, before_ns + wait_ns, scans, poses)
        return max(1, round((self.stamp_ns - before_ns) / self._step_ns))

    def halt(self, robots: Iterable[int]) -> None:
        """Have robots stand still, in a simulation that goes on."""
        if not self._lock_step:
            self._link.send([Velocity(robot=robot, stamp_ns=self.stamp_ns, linear=0.0, angular=0.0) for robot in robots])

    def _look(self, robots: Sequence[int], due_ns: int, scans: np.ndarray, poses: np.ndarray) -> None:
        limit_s = self._settings.deadline_s
        deadline = time.monotonic() + limit_s
        silent_at = time.monotonic() + self._profile.watchdog_s
        while missing := self._readings.missing(robots, due_ns):
            now = time.monotonic()
            if now > deadline:
                who = ", ".join(map(str, missing))
                raise EvaluationError(f"no scan and pose of robot {who} at {due_ns / NS:g} s within {limit_s:g} s (deadline_s)")
            if now > silent_at:
                self.halt(robots)
                silent_at = deadline
            self._take(max(0.0, min(deadline, silent_at) - now))
        self.stamp_ns = self._readings.fill(robots, scans, poses)

    def _wait_for_the_clock_to_go_back(self, before_ns: int) -> None:
        deadline = time.monotonic() + self._settings.deadline_s
        while self._readings.clock_ns == 0 or 0 < before_ns <= self._readings.clock_ns:
            if time.monotonic() > deadline:
                raise EvaluationError(f"no trial began within {self._settings.deadline_s:g} s (deadline_s)")
            self._readings.forget()
            self._take(self._settings.deadline_s)

    def _listen(self, for_s: float) -> None:
        """Take what came, and what comes for a while."""
        until = time.monotonic() + for_s
        while self._take(max(0.0, until - time.monotonic())) and time.monotonic() < until + FLOODED_S:
            pass

    def _take(self, timeout_s: float) -> bool:
        """Take the next message if one comes in time, or a little earlier, to see whether the node is there."""
        message = self._link.receive(min(timeout_s, LOOKED_S))
        if message is not None:
            self._readings.take(message)
        elif self._node is not None:
            self._node.next(0.0)  # which says that it ended
        return message is not None


def _node(settings: Settings, here: Graph, channels: str) -> list[str]:
    """How to start a node of one's own."""
    of_world = {field: getattr(settings, field) for field in turtlebot_exit.Settings.__struct_fields__}
    endpoints = [word for endpoint in here.listen for word in ("--listen", endpoint)]
    return [
        *(sys.executable, "-m", "zswarm.ros.node", "--child", "--link", here.link, "--master", here.master),
        *("--domain", str(here.domain), *endpoints, "--profile", settings.profile_or_default, "--channels", channels),
        *("--mode", settings.mode, "--rate", str(settings.rate), "--deadline-s", str(settings.deadline_s)),
        *("--settings", msgspec.json.encode(of_world).decode()),
    ]


@contextlib.contextmanager
def _alone_with(here: Graph) -> Iterator[None]:
    """Hold a running simulation against other slots of this machine.

    Raises:
        EvaluationError: one drives it.
    """
    name = hashlib.blake2b(msgspec.json.encode(here), digest_size=8).hexdigest()
    with Path(tempfile.gettempdir(), f"zswarm-ros-{name}.lock").open("w") as held:
        try:
            fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise EvaluationError("another slot drives this simulation; one server with --capacity 1 was expected") from None
        yield
