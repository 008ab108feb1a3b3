"""A ROS simulation as a slot drives it: its own node, or one that already runs."""

import contextlib
import os
import sys
import time
import weakref
from collections.abc import Iterable, Iterator, Sequence

import msgspec
import numpy as np

from zswarm.errors import EvaluationError
from zswarm.robots.profiles.profile import Channel, Profile
from zswarm.ros.launch.roslaunch import Supervisor
from zswarm.ros.link import graph
from zswarm.ros.link.child import Child
from zswarm.ros.link.graph import RosGraph
from zswarm.ros.link.link import Link
from zswarm.ros.link.messages import ResetWorld, Velocity
from zswarm.ros.simulation.machine import FoundSimulation
from zswarm.ros.simulation.pairing import Readings
from zswarm.ros.simulation.settings import RosSettings
from zswarm.sims import turtlebot_exit
from zswarm.sims.simulator import RobotInterface
from zswarm.system.locks import locked
from zswarm.system.processes import MODULE, ending

NS = 1_000_000_000
READY_S = 30.0  # for both sides to find each other
LISTEN_S = 0.2  # to a simulation that may be running, before a trial and after its reset
FLOOD_S = 0.5  # spent at most on messages that come faster than they are taken
LOOK_S = 0.2  # between checks of the node
SOON = 0.75  # of a step: a scan so much later is the next, while the interval is unknown
BEHIND = 5  # steps that scans are older than the clock, in a simulation that is too fast
OFF = 0.1  # of a step, that the simulation's own steps may differ from it


class Simulation:
    """A simulation at work, until it is closed or garbage-collected."""

    def __init__(
        self,
        settings: RosSettings,
        profile: Profile,
        interface: RobotInterface,
        machine: FoundSimulation | None = None,
    ) -> None:
        """Start the link, and the node if it is the slot's own.

        Args:
            machine: the simulation to drive, of a file of this machine; None: the slot's own.
        """
        self._settings, self._profile = settings, profile
        self._robots, self._lock_step = settings.robots, settings.mode == "lock-step"
        self._step_ns = round(settings.step_s * NS)
        self._node: Child | None = None
        self.stamp_ns = 0
        self._began = (
            0.0,
            0,
        )  # the trial: when, by the monotonic clock, and at which stamp
        self._was_reset: ResetWorld | None = None  # by a service that returned
        self._is_simulated = machine is None or not machine.simulation.real_robots
        self._supervisor: Supervisor | None = None
        pose: Channel = "odometry" if profile.ground_truth is None else "ground_truth"
        self._readings = Readings(interface, truth=pose == "ground_truth")
        used: list[Channel] = ["velocity", "scan", pose, "reset"]
        # Of robots that are not simulated none is published, so the link is never ready.
        if not (self._lock_step and (machine is None or machine.simulation.real_robots)):
            used.append("clock")
        with contextlib.ExitStack() as opened:
            here = self._open_graph(opened, machine, f"scan,{pose}")
            link = Link(
                here,
                profile,
                robots=self._robots,
                side="controllers",
                channels=used,
                stamped_resets=profile.reset.service and not self._lock_step,
            )
            self._link = opened.enter_context(link)
            self._link.ready(READY_S, check=self._check_runs)
            self.close = weakref.finalize(self, opened.pop_all().close)

    def _open_graph(
        self, opened: contextlib.ExitStack, machine: FoundSimulation | None, channels: str
    ) -> RosGraph:
        """Return the graph of the simulation, after starting it where that is for the slot."""
        settings, distribution = self._settings, self._profile.distribution
        if machine is None:
            here = opened.enter_context(graph.private(settings.link))
            command = _node(settings, here.dialled(), channels)
            self._node = Child(
                "the simulation node", command, here.environment(distribution), {}
            )
            opened.callback(self._node.close)
        elif machine.simulation.launch:
            here = opened.enter_context(graph.private(machine.simulation.link))
            self._supervisor = Supervisor()
            opened.callback(self._supervisor.close)
            self._supervisor.start(
                machine.simulation.command,
                machine.folder,
                {**os.environ, **here.environment(distribution)},
            )
        else:
            here = machine.simulation.graph()
            opened.enter_context(_alone_with(here))
        return here

    def begin(self, seed: int, scans: np.ndarray, poses: np.ndarray) -> None:
        """Begin a trial, and fill all robots' scans and poses; see ``Readings.fill``."""
        if self._lock_step and self._profile.reset.service:
            self._begin_in_steps(seed, scans, poses)
            return
        self.halt(range(self._robots))  # that may drive as a stranded slot decided
        if not self._lock_step:
            self._listen(LISTEN_S)
        before_ns = self._readings.clock_ns
        self._ask_reset(seed)
        due_ns = self._step_ns
        if self._profile.reset.service:  # its clock is not reset
            due_ns += self._await_return()
            self._listen(LISTEN_S)
        elif not self._lock_step:
            self._await_reset(before_ns)
        self._look(range(self._robots), due_ns, scans, poses)
        self._began = time.monotonic(), self.stamp_ns

    def rate(self) -> float:
        """Return how many times as fast as real time the trial was since its first readings."""
        at, stamp_ns = self._began
        return (self.stamp_ns - stamp_ns) / NS / (time.monotonic() - at)

    def drive(
        self, robots: Iterable[int], linear: np.ndarray, angular: np.ndarray
    ) -> bool:
        """Publish velocities; return whether the clock was past the scans they are based on."""
        late = False
        if not self._lock_step:
            self._listen(0.0)
            late = self._readings.clock_ns > self.stamp_ns
        stamp_ns = self.stamp_ns
        sent = [
            Velocity(robot=at, stamp_ns=stamp_ns, linear=linear[at], angular=angular[at])
            for at in robots
        ]
        if (
            self._lock_step and self._profile.reset.service
        ):  # it waits for those that are out
            driven = {velocity.robot for velocity in sent}
            sent += self._still(at for at in range(self._robots) if at not in driven)
        self._link.send(sent)
        return late

    def look(self, robots: Sequence[int], scans: np.ndarray, poses: np.ndarray) -> int:
        """Wait for the next readings of robots, and fill them; return how many steps passed."""
        before_ns = self.stamp_ns
        self._look(robots, before_ns + self._wait_ns(), scans, poses)
        return max(1, round((self.stamp_ns - before_ns) / self._step_ns))

    def halt(self, robots: Iterable[int]) -> None:
        """Stop robots in a simulation that does not wait."""
        if not self._lock_step:
            self._link.send(self._still(robots))

    def _still(self, robots: Iterable[int]) -> list[Velocity]:
        """Return velocities of robots that stand."""
        still = Velocity(robot=0, stamp_ns=self.stamp_ns, linear=0.0, angular=0.0)
        return [msgspec.structs.replace(still, robot=robot) for robot in robots]

    def _ask_reset(self, seed: int) -> None:
        self._readings.forget()
        self._was_reset = None
        self._link.send([ResetWorld(seed=seed)])

    def _begin_in_steps(self, seed: int, scans: np.ndarray, poses: np.ndarray) -> None:
        """Begin a trial of a simulation that waits, at multiples of ``step_s``, and resets there.

        See ``examples/ros/stage/lockstep.cc``.
        """
        every = range(self._robots)
        self._ask_reset(seed)
        self._await_return()
        if not self.stamp_ns:  # readings may be on their way that no trial waited for
            self._listen(LISTEN_S)
        self._link.send(self._still(every))
        self._look(every, self._readings.clock_ns + 1, scans, poses)
        steps = -(-self.stamp_ns // self._step_ns)
        self._look(every, steps * self._step_ns, scans, poses)

    def _look(
        self, robots: Sequence[int], due_ns: int, scans: np.ndarray, poses: np.ndarray
    ) -> None:
        limit_s = self._settings.deadline_s
        deadline = time.monotonic() + limit_s
        silent_at = time.monotonic() + self._profile.watchdog_s
        while missing := self._readings.missing(robots, due_ns):
            now = time.monotonic()
            if now > deadline:
                raise EvaluationError(
                    f"no scan and pose of robot {', '.join(map(str, missing))} "
                    f"at {due_ns / NS:g} s within {limit_s:g} s (deadline_s)"
                    f"{self._behind(robots)}"
                )
            if now > silent_at:
                self.halt(robots)
                silent_at = deadline
            self._take(max(0.0, min(deadline, silent_at) - now))
        self.stamp_ns = self._readings.fill(robots, due_ns, scans, poses)

    def _behind(self, robots: Iterable[int]) -> str:
        """Return words for scans that arrive late because the simulation is too fast."""
        behind_ns = self._readings.behind_ns(robots)
        if behind_ns < BEHIND * self._step_ns:
            return ""
        return (
            f": scans arrive {behind_ns / NS:.2g} s of the simulation late, which is too fast "
            "for this machine; slow it down, see docs/ros.md"
        )

    def _wait_ns(self) -> int:
        """Return how much later than the last a scan is to be the next.

        Raises:
            EvaluationError: the simulation has no scans ``step_s`` apart.
        """
        interval_ns, step_ns = self._readings.interval_ns, self._step_ns
        if self._lock_step:
            return step_ns
        if not interval_ns:
            return round(SOON * step_ns)
        nearest_ns = round(step_ns / interval_ns) * interval_ns
        if self._is_simulated and abs(nearest_ns - step_ns) > OFF * step_ns:
            raise EvaluationError(
                f"step_s is {step_ns / NS:g}, and the simulation sends scans every "
                f"{interval_ns / NS:g} s; expected a multiple of that"
            )
        return step_ns - interval_ns // 2

    def _await_return(self) -> int:
        """Wait until the service that resets returned; return a time since then, ns.

        In lock-step it is 0: then the simulation waits.
        """
        limit_s, name = self._settings.deadline_s, self._profile.reset.name
        deadline = time.monotonic() + limit_s
        while self._was_reset is None:
            if time.monotonic() > deadline:
                raise EvaluationError(
                    f"{name} did not return within {limit_s:g} s (deadline_s)"
                )
            self._take(limit_s)
        return self._was_reset.stamp_ns

    def _await_reset(self, before_ns: int) -> None:
        """Wait until the clock restarted."""
        limit_s = self._settings.deadline_s
        deadline = time.monotonic() + limit_s
        while self._readings.clock_ns == 0 or 0 < before_ns <= self._readings.clock_ns:
            if time.monotonic() > deadline:
                raise EvaluationError(
                    f"no trial began within {limit_s:g} s (deadline_s): the clock did not restart "
                    f"after a message on {self._profile.reset.name}; expected a profile with the "
                    "reset that this simulation has, see docs/profiles.md"
                )
            self._readings.forget()
            self._take(limit_s)

    def _listen(self, for_s: float) -> None:
        """Take waiting messages, and those that arrive for a while."""
        until = time.monotonic() + for_s
        while self._take(max(0.0, until - time.monotonic())):
            if time.monotonic() >= until + FLOOD_S:
                break

    def _take(self, timeout_s: float) -> bool:
        """Take the next message; return early without one, so that the node is checked often."""
        message = self._link.receive(min(timeout_s, LOOK_S))
        if isinstance(message, ResetWorld):
            self._was_reset = message
        elif message is not None:
            self._readings.take(message)
        else:
            self._check_runs()
        return message is not None

    def _check_runs(self) -> None:
        """Raise if the program that simulates for this slot ended."""
        if self._node is not None:
            self._node.next(0.0)
        if self._supervisor is not None and (ended := self._supervisor.ended()):
            raise EvaluationError(f"the simulation {ending(*ended)}")


def _node(settings: RosSettings, here: RosGraph, channels: str) -> list[str]:
    """Return the command of a slot's own node."""
    fields = turtlebot_exit.TurtlebotExitSettings.__struct_fields__
    world = {field: getattr(settings, field) for field in fields}
    options = {
        "--link": here.link,
        "--master": here.master,
        "--domain": here.domain,
        "--profile": settings.profile_or_default,
        "--channels": channels,
        "--mode": settings.mode,
        "--rate": settings.rate,
        "--deadline-s": settings.deadline_s,
        "--settings": msgspec.json.encode(world).decode(),
    }
    command = [sys.executable, *MODULE, "zswarm.ros.simulation.node", "--child"]
    command += [str(word) for option in options.items() for word in option]
    return command + [word for endpoint in here.listen for word in ("--listen", endpoint)]


@contextlib.contextmanager
def _alone_with(here: RosGraph) -> Iterator[None]:
    """Reserve a running simulation against other slots of this machine."""
    try:
        held = locked(msgspec.json.encode(here.identity()))
    except BlockingIOError:
        raise EvaluationError(
            "another slot drives this simulation; one server with --capacity 1 was expected"
        ) from None
    except OSError as error:
        raise EvaluationError(
            f"the lock of this simulation cannot be taken: {error.filename}: {error.strerror}"
        ) from None
    with contextlib.closing(held):
        yield
