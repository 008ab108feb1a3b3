"""The contract of a simulator.

A simulator plays a trial in turns. A turn names the agents that act next and what they observe: all of them, or one in
worlds where agents move one after another. Each agent belongs to a participant, whose genome drives it. A simulator
sees observations and actions only, never the network behind them.

``Simulator`` is all that a plug-in needs. ``CompiledSimulator`` adds one method that plays whole trials inside a compiled
kernel; its turns must give the same bits. ``HostingSimulator`` may play whole trials with networks of its own.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Literal, NamedTuple

import msgspec
import numpy as np

from zswarm.jit import Step

MAX_TURNS = 1_000_000  # of a trial; one that goes on is taken to have no end


class Turn(NamedTuple):
    """Who acts next, and what they observe."""

    agents: Sequence[int]
    observations: np.ndarray  # (len(agents), inputs) float32


class Outcome(NamedTuple):
    """What a trial decided."""

    fitness: Sequence[float]  # one per participant, higher is better
    metrics: Sequence[float]  # in the order of Simulator.metrics


class Body(NamedTuple):
    """Something that moves; lengths as in its ``Frame``."""

    kind: str  # what people call it: "robot", "defender"; may change, such as to "robot with the flag"
    x: float  # of its centre
    y: float
    radius: float  # half the side of a square
    heading: float | None = None  # radians from the x axis clockwise, where it looks; of a square, how far it is turned
    shape: Literal["disc", "square", "triangle", "diamond"] = "disc"  # those of unlike teams or sorts differ; stays


class Place(NamedTuple):
    """Something that stays where it is, as a rectangle."""

    kind: str  # what people call it: "exit", "wall"
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
    """Words in the picture, such as a score; they may change."""

    text: str
    x: float  # of its middle
    y: float
    size: float  # of its letters


class Ray(NamedTuple):
    """A distance sensor, the same in each agent: shown from the agent's body, as long as what it reads says."""

    sensor: int  # index of its number in an observation
    angle: float  # radians from the body's heading clockwise; from the x axis where the body has none
    at_0: float  # its length where that number is 0
    at_1: float  # where it is 1
    spread: float = 0.0  # radians that it looks at, half of them on each side; 0 for a beam
    aside: float = 0.0  # it begins so far on the right of the body's centre


class Frame(NamedTuple):
    """What a picture of the present state needs; lengths in the simulator's unit, x to the right and y downwards from (0, 0).

    Bodies and lines are in the same order throughout a trial, the agents' bodies first. Places and rays stay as they are.
    """

    width: float
    height: float
    places: Sequence[Place]
    bodies: Sequence[Body]
    lines: Sequence[Line] = ()
    labels: Sequence[Label] = ()
    rays: Sequence[Ray] = ()


class RobotInterface(msgspec.Struct, frozen=True, kw_only=True):
    """How a robot's messages become what controllers observe, and what they decide its velocity; see ``robot_interface``."""

    rays: int  # of the laser scanner
    view: float  # radians from the first ray, on the right, to the last, half of them to each side
    range: float  # m; so much is read where nothing is
    sectors: int  # parts of the scan that are observed, from the right to the left
    targets: tuple[tuple[float, float], ...]  # m: x, y; the direction of the nearest one is observed
    arrived: float  # m from a target at which a robot is done
    speed: float  # m/s at most
    turn: float  # rad/s at most
    step_s: float  # a controller decides once in each
    radius: float  # m, of a robot


class Simulator(ABC):
    """One problem with its settings.

    A whole one, in which three robots on a line gather::

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

    A trial is ``reset``, then ``step`` until it gives None, then ``outcome``. What it draws comes from the seed alone; nothing is
    left over from earlier trials. Observations are finite and not changed later. What raises or breaks a rule makes the trial's
    fitness NaN, as do ``MAX_TURNS`` turns without an end. ``zswarm.testing.check_simulator`` says which rule is broken.

    Attributes:
        settings_type: the struct of its settings in an experiment file.
        metrics: names of what a trial reports beside fitness.
        participants: genomes that play one trial together.
        inputs, outputs: numbers an agent observes and sets in one decision.
        sensors, actuators: their names, for robots; may be empty.
        owners: per agent the participant that drives it.
        robot: how its controllers drive a real robot; None where they fit none.
        repeatable: the same genomes and seed have the same outcome; if not, servers are not compared by what they compute.
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
        """The seeds of an experiment's trials where the problem itself fixes them, else None."""
        return None

    @abstractmethod
    def reset(self, seed: int) -> Turn:
        """Start a trial; the same seed gives the same trial."""

    @abstractmethod
    def step(self, actions: np.ndarray) -> Turn | None:
        """Let the agents of the last turn act; None when the trial is over.

        Args:
            actions: (agents of the turn, outputs) float32.
        """

    @abstractmethod
    def outcome(self) -> Outcome:
        """The outcome of the trial that ended."""

    def frame(self) -> Frame | None:
        """What a picture of the present state needs; None where there is nothing to draw."""
        return None


class Batch(NamedTuple):
    """Trials that a kernel plays, and what it fills."""

    state_size: int  # float32 numbers of state per agent, zero at the start of each trial
    parameters: np.ndarray  # (genomes, P) float32
    participants: np.ndarray  # (trials, k) int64, rows of ``parameters``
    seeds: np.ndarray  # (trials,) uint64
    progress: np.ndarray  # (2,) int64
    fitness: np.ndarray  # (trials, k) float64, filled
    metrics: np.ndarray  # (trials, len(Simulator.metrics)) float64, filled


class CompiledSimulator(Simulator):
    """A simulator that plays whole trials in a compiled kernel."""

    @abstractmethod
    def play(self, step: Step, batch: Batch) -> None:
        """Play trials in order; before each set ``progress[0]`` to its index and stop if ``progress[1]`` is not zero.

        Args:
            step: the controllers' compiled decision.
        """

    def play_lanes(self, step_lanes: Step, step: Step, batch: Batch) -> None:  # noqa: ARG002  for those that override it
        """``play`` where the controllers decide for eight agents at once, too; a simulator that gains from it overrides this.

        Bits must be those of ``play``. Trials that are played side by side set ``progress[0]`` once, to the first of them.

        Args:
            step_lanes: the decision of eight agents, see ``Representation.step_lanes``.
        """
        self.play(step, batch)


class HostingSimulator(Simulator):
    """A simulator that may decide for the controllers itself, as one outside of this process; with the bits of its turns.

    Attributes:
        hosted: the representation that it decides for, from ``host`` on.
    """

    hosted: object = None

    @abstractmethod
    def host(self, kind: str, settings: Mapping[str, Any]) -> bool:
        """Prepare for controllers of a kind, an experiment's ``[representation]``; whether it decides for them."""

    @abstractmethod
    def play_alone(self, genomes: Sequence[bytes], seed: int) -> Outcome:
        """Play a whole trial of the genomes of all participants."""
