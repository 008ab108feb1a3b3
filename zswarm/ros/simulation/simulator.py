"""``turtlebot-exit-ros``: turtlebot-exit with a ROS simulation as its world, driven by messages.

The slot's process receives scans and poses, asks the controllers, and publishes velocities: nothing
is started or compiled for a candidate. In lock-step the simulation waits for all velocities of a
step, and a trial has the bits of ``turtlebot-exit``. ROS is needed only when a trial is played.
"""

import contextlib
import sys
from collections.abc import Iterator

import numpy as np

from zswarm.errors import ConfigError, EvaluationError
from zswarm.kernels.portable import atan2
from zswarm.robots.profiles import profile as profiles
from zswarm.robots.profiles.profile import Profile
from zswarm.ros.simulation import machine
from zswarm.ros.simulation.machine import FoundSimulation
from zswarm.ros.simulation.settings import OWN, RosSettings
from zswarm.ros.simulation.simulation import Simulation
from zswarm.sims.robot_interface import fit
from zswarm.sims.simulator import Frame, Outcome, Simulator, Turn
from zswarm.sims.turtlebot_exit import ExitTask, TurtlebotExit

NAME = "turtlebot-exit-ros"
NEW = 1.25  # a rate is reported that differs by this factor from the last one


class TurtlebotExitRos(Simulator):
    """turtlebot-exit, played by a ROS simulation; observations and decisions are ROS messages.

    Observation, action, start, end and fitness: as turtlebot-exit; in lock-step with the same bits.
    Turns: all robots that are still inside, at once, every ``step_s`` of the simulation's clock.
    Metrics: those of turtlebot-exit, and ``late_fraction``: the share of velocities that were sent
        when the clock was past their scan's stamp; ``missed``: the share of steps in which robots
        did not decide, since the simulation did not wait; ``rate``: how many times as fast as real
        time the simulation was. All are 0 in lock-step.
    """

    settings_type = RosSettings
    metrics = (*TurtlebotExit.metrics, "late_fraction", "missed", "rate")
    sensors, actuators = TurtlebotExit.sensors, TurtlebotExit.actuators
    inputs, outputs = TurtlebotExit.inputs, TurtlebotExit.outputs
    settings: RosSettings

    def __init__(self, settings: RosSettings) -> None:
        super().__init__(settings)
        # Checks the settings, and draws pictures; it plays no trial.
        self._inside = TurtlebotExit(settings)
        self.task = ExitTask(settings)
        self.owners, self.robot = self._inside.owners, self.task.interface
        own = settings.simulation == OWN
        self.repeatable = settings.mode == "lock-step" and (own or settings.repeatable)
        self._machine: FoundSimulation | None = None
        self._profile: Profile | None = None
        if own:
            self._profile = self._checked(profiles.read(settings.profile_or_default))
        self._scans = np.zeros((settings.robots, settings.rays), np.float32)
        # x, y, and z, w of the quaternion; a robot that is out keeps its last pose.
        self.poses = np.zeros((settings.robots, 4))
        self._simulation: Simulation | None = None
        self._rate = self._reported_rate = 0.0

    def use_machine(self) -> None:
        """Let trials drive the simulation that a file of this machine names."""
        if self.settings.simulation != OWN:
            self._machine = machine.find(self.settings.simulation)
            self._profile = self._checked(self._machine.profile)

    def reset(self, seed: int) -> Turn:
        """Have the simulation begin a trial."""
        self._seed, self._late, self._sent = seed, 0, 0
        self._turns, self._passed = 0, 0  # decisions of the trial, and its steps
        with self._running() as simulation:
            simulation.begin(seed, self._scans, self.poses)
        return self.task.begin(self._scans, self.poses)

    def step(self, actions: np.ndarray) -> Turn | None:
        """Publish the robots' decisions, and wait for their next readings."""
        self.task.decide(actions)
        agents = self.task.agents.tolist()
        with self._running() as simulation:
            late = simulation.drive(agents, self.task.linear, self.task.angular)
            passed = simulation.look(agents, self._scans, self.poses)
            self._sent += len(agents)
            self._late += late * len(agents)
            turn, out = self.task.go_on(self._scans, self.poses, passed)
            simulation.halt(agents if turn is None else out)
            if self.settings.mode == "free-running":
                self._rate = simulation.rate()
            self._count(passed, over=turn is None)
        if turn is None:
            self._report_rate()
        return turn

    def outcome(self) -> Outcome:
        """Return fitness and metrics of the trial that ended."""
        decided = self.task.outcome()
        missed = 1 - self._turns / self._passed
        late = self._late / self._sent
        return Outcome(decided.fitness, [*decided.metrics, late, missed, self._rate])

    def frame(self) -> Frame:
        """Return the picture of turtlebot-exit."""
        angles = [2 * atan2(z, w) for _, _, z, w in self.poses.tolist()]
        return self._inside.picture(
            np.column_stack([self.poses[:, :2], angles]), self.task.agents
        )

    def close(self) -> None:
        """End the simulation; the next trial starts it again."""
        if self._simulation is not None:
            self._simulation.close()
        self._simulation = None

    def _count(self, passed: int, *, over: bool) -> None:
        """Count a decision and the steps until the next; refuse a trial that missed too many."""
        left = self.settings.steps - self._passed
        self._turns, self._passed = self._turns + 1, self._passed + min(passed, left)
        missed, limit = self._passed - self._turns, self.settings.missed_limit
        if missed > limit * (self._passed if over else self.settings.steps):
            raise EvaluationError(
                f"{missed} of {self._passed} steps passed without a decision: the simulation runs "
                f"at {self._rate:.2g} times real time, about {self._passed / self._turns:.1f} "
                "times too fast for this machine; expected a share of at most "
                f"{limit:g} (missed_limit): slow it down, see docs/ros.md"
            )

    def _report_rate(self) -> None:
        """Write how fast the simulation was, which servers log, if that is new."""
        if self._rate and not 1 / NEW < self._rate / (self._reported_rate or 1e-9) < NEW:
            self._reported_rate = self._rate
            name = self.settings.simulation
            sys.stderr.write(
                f"simulation {name!r} runs at {self._rate:.2g} times real time\n"
            )

    @contextlib.contextmanager
    def _running(self) -> Iterator[Simulation]:
        """Provide the simulation; its errors are the machine's, and end it."""
        try:
            if self._profile is None:
                raise EvaluationError(
                    f"simulation {self.settings.simulation!r} is driven by slots of servers only; "
                    f'expected simulation = "{OWN}" here'
                )
            if self._simulation is None:
                self._prepare()
                self._simulation = Simulation(
                    self.settings, self._profile, self.task.interface, self._machine
                )
            yield self._simulation
        except (ConfigError, EvaluationError) as error:
            self.close()
            raise EvaluationError(
                f"simulator {NAME!r}, trial seed {self._seed}: {error}"
            ) from None

    def _prepare(self) -> None:
        """Load what a step needs: a simulation that does not wait leaves no time for it."""
        fit(self._scans[0], 0.0, 1.0, 1.0, np.float32(1), self._scans[0].copy())
        self.task.begin(self._scans, self.poses)
        self.task.decide(np.full((self.settings.robots, self.outputs), 0.5, np.float32))

    def _checked(self, profile: Profile) -> Profile:
        if self.settings.mode == "free-running" and profile.clock is None:
            raise ConfigError(f"{NAME}: mode: free-running needs a profile with a clock")
        return profile
