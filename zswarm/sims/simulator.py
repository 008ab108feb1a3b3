"""The contract of a simulator.

A simulator plays a trial in turns. A turn names the agents that act next and what they observe: all
of them, or one in worlds where agents move one after another. Each agent belongs to a participant,
whose genome drives it. A simulator sees observations and actions only, never the network behind
them.

``Simulator`` is all that a plug-in needs. ``CompiledSimulator`` adds one method that plays whole
trials inside a compiled kernel; its turns must give the same bits. ``HostingSimulator`` may play
whole trials with networks of its own.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta

from zswarm.config.meta import within
from zswarm.kernels.signatures import (
    Float32Rows,
    Float64Rows,
    Int64Rows,
    Int64s,
    Step,
    UInt64s,
)

Amount = Annotated[float, Meta(ge=0, le=1e6)]  # of m, s, or per s
Coordinate = Annotated[float, Meta(ge=-1e6, le=1e6)]  # m
Place = tuple[Coordinate, Coordinate]
Steps = Annotated[int, within(1, 1_000_000, "steps of a trial")]  # a setting of many
MAX_TURNS = 1_000_000  # of a trial; a longer one has no end


class Turn(NamedTuple):
    """The agents that act next, and their observations."""

    agents: Sequence[int]
    observations: np.ndarray  # (len(agents), inputs) float32


class Outcome(NamedTuple):
    """The result of a trial."""

    fitness: Sequence[float]  # one per participant, higher is better
    metrics: Sequence[float]  # in the order of Simulator.metrics


class Body(NamedTuple):
    """Something that moves; lengths as in its ``Frame``."""

    kind: str  # as shown to people: "robot"; it may change, such as to "robot with the flag"
    x: float  # of its centre
    y: float
    radius: float  # half the side of a square
    # Radians from the x axis clockwise; a square is turned by it.
    heading: float | None = None
    # Constant; by team or sort.
    shape: Literal["disc", "square", "triangle", "diamond"] = "disc"


class Rectangle(NamedTuple):
    """Something that does not move, drawn as a rectangle."""

    kind: str  # as shown to people: "exit", "wall"
    x: float  # of its upper left corner
    y: float
    width: float
    height: float


class Line(NamedTuple):
    """Something long that moves: a rod, a rope."""

    kind: str
    x: float  # of one end
    y: float
    to_x: float
    to_y: float


class Label(NamedTuple):
    """Text in the picture, such as a score; it may change."""

    text: str
    x: float  # of its middle
    y: float
    size: float  # of its letters


class Ray(NamedTuple):
    """A distance sensor, which all agents have; it is drawn from the body as long as it reads."""

    sensor: int  # index of its number in an observation
    angle: float  # radians clockwise from the body's heading, or from the x axis if it has none
    at_0: float  # its length where that number is 0
    at_1: float  # where it is 1
    spread: float = 0.0  # radians that it covers, half of them to each side; 0 for a beam
    aside: float = 0.0  # how far to the right of the body's centre it begins


class Frame(NamedTuple):
    """A picture of the present state, in the simulator's unit, x right and y down from (0, 0).

    Bodies and lines keep their order throughout a trial, the agents' bodies first. Places and rays
    do not change.
    """

    width: float
    height: float
    places: Sequence[Rectangle]
    bodies: Sequence[Body]
    lines: Sequence[Line] = ()
    labels: Sequence[Label] = ()
    rays: Sequence[Ray] = ()


class RobotInterface(msgspec.Struct, frozen=True, kw_only=True):
    """How messages become observations, and decisions velocities: ``robot_interface``.

    A champion's file has it, so that it can be exported where its simulator is not.
    """

    rays: Annotated[int, Meta(ge=2, le=100_000)]  # of the laser scanner
    # Radians from the first ray, on the right, to the last, half of them to each side.
    view: Annotated[float, Meta(gt=0, le=7)]
    range: Amount  # m; read where nothing is nearer
    # Parts of the scan that are observed, from the right to the left.
    sectors: Annotated[int, Meta(ge=1, le=100_000)]
    # m: x, y; the direction of the nearest is observed.
    targets: Annotated[tuple[Place, ...], Meta(min_length=1, max_length=10_000)]
    arrived: Amount  # m from a target at which a robot is done
    speed: Amount  # m/s at most
    turn: Amount  # rad/s at most
    step_s: Amount  # a controller decides once in each
    radius: Amount  # m, of a robot


class Simulator(ABC):
    """One problem with its settings.

    This one is complete; three robots on a line gather::

        class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
            steps: int = 50

        class Gather(Simulator):
            settings_type = Settings
            inputs, outputs, owners = 2, 1, (0, 0, 0)

            def reset(self, seed):
                self.x, self.left = Stream(seed).uniform(0.0, 10.0, 3), self.settings.steps
                return self.turn()

            def step(self, actions):
                self.x, self.left = self.x + actions[:, 0] - 0.5, self.left - 1
                return self.turn() if self.left > 0 else None

            def outcome(self):
                return Outcome([float(self.x.min() - self.x.max())], [])

            def turn(self):
                observations = np.stack([self.x - self.x.min(), self.x.max() - self.x], axis=1)
                return Turn(range(3), observations.astype(np.float32))

    A trial is ``reset``, then ``step`` until it returns None, then ``outcome``. It depends on the
    seed alone. Observations are finite and do not change later. If it raises, breaks a rule
    (``check_simulator`` names it) or takes ``MAX_TURNS`` turns, its fitness is NaN.

    Attributes:
        settings_type: the struct of its settings in an experiment file.
        metrics: names of the numbers that a trial reports in addition to fitness.
        participants: genomes that play one trial together.
        inputs, outputs: numbers an agent observes and sets in one decision.
        sensors, actuators: their names, for robots; may be empty.
        owners: per agent the participant that drives it.
        robot: how its controllers drive a real robot; None if they cannot.
        repeatable: whether the same genomes and seed have the same outcome; servers are compared.
    """

    settings_type: ClassVar[type[msgspec.Struct]]
    metrics: tuple[str, ...] = ()
    participants: int = 1
    inputs: int
    outputs: int
    sensors: Sequence[str] = ()
    actuators: Sequence[str] = ()
    owners: Sequence[int]
    robot: RobotInterface | None = None
    repeatable: bool = True

    def __init__(self, settings: msgspec.Struct) -> None:
        self.settings = settings

    def fixed_seeds(self, trials: int) -> Sequence[int] | None:  # noqa: ARG002  for those that override it
        """Return the seeds of an experiment's trials if the problem fixes them, else None."""
        return None

    def use_machine(self) -> None:  # noqa: B027  few simulators need it
        """Let trials drive what is outside of zswarm's own programs, such as robots.

        Only the slots of servers call this. Without it a trial must not reach anything outside.

        Raises:
            ConfigError: this machine has nothing that the settings name.
        """

    @abstractmethod
    def reset(self, seed: int) -> Turn:
        """Start a trial; the same seed starts the same trial."""

    @abstractmethod
    def step(self, actions: np.ndarray) -> Turn | None:
        """Let the agents of the last turn act; return None when the trial is over.

        Args:
            actions: (agents of the turn, outputs) float32.
        """

    @abstractmethod
    def outcome(self) -> Outcome:
        """Return the outcome of the trial that ended."""

    def frame(self) -> Frame | None:
        """Return a picture of the present state; None if there is nothing to draw."""
        return None


class KernelBatch(NamedTuple):
    """Trials for a kernel, and the arrays that it fills."""

    state_size: int  # float32 numbers of state per agent, zero at the start of each trial
    parameters: Float32Rows  # (genomes, P)
    participants: Int64Rows  # (trials, k), rows of ``parameters``
    seeds: UInt64s  # (trials,)
    progress: Int64s  # (2,)
    fitness: Float64Rows  # (trials, k), filled
    metrics: Float64Rows  # (trials, len(Simulator.metrics)), filled


class CompiledSimulator(Simulator):
    """A simulator that plays whole trials in a compiled kernel."""

    @abstractmethod
    def play(self, step: Step, batch: KernelBatch) -> None:
        """Play trials in order.

        Before each trial, set ``progress[0]`` to its index and stop if ``progress[1]`` is not zero.

        Args:
            step: the controllers' compiled decision.
        """

    def play_lanes(self, step_lanes: Step, step: Step, batch: KernelBatch) -> None:  # noqa: ARG002
        """Play as ``play``, with controllers that can decide for eight agents at once.

        A simulator overrides this if it is faster; the bits must be those of ``play``. For trials
        that are played in parallel, ``progress[0]`` is the index of the first.

        Args:
            step_lanes: the decision of eight agents, see ``Representation.step_lanes``.
        """
        self.play(step, batch)


class HostingSimulator(Simulator):
    """A simulator that can run the controllers itself, such as a third-party program.

    Its outcomes have the bits of those in turns.

    Attributes:
        hosted: the representation that it runs, after ``host``.
    """

    hosted: object = None

    @abstractmethod
    def host(self, kind: str, settings: Mapping[str, Any]) -> bool:
        """Prepare for controllers of a ``[representation]``; return whether that is possible."""

    @abstractmethod
    def play_alone(self, genomes: Sequence[bytes], seed: int) -> Outcome:
        """Play a whole trial with the genomes of all participants."""
