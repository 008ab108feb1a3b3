"""The champion of a run as a file for other programs: ``champion.zsc`` (docs/record.md)."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import msgspec
import numpy as np
from msgspec import Meta

from zswarm.champion.held_out import HeldOut
from zswarm.config.decode import convert
from zswarm.errors import ConfigError
from zswarm.plugins import registry as plugins
from zswarm.sims.simulator import RobotInterface
from zswarm.system.format import per_trial, with_trials
from zswarm.system.text import clean

if TYPE_CHECKING:  # imports the compiler
    from zswarm.nets.representation import Representation

CHAMPION = "champion.zsc"
MOST = 1_000_000  # numbers that an agent observes, or sets: a file with more is not a controller


class Controller(
    msgspec.Struct, frozen=True, kw_only=True, tag="zswarm-controller", tag_field="format"
):
    """The content of ``champion.zsc``: what another program needs to run the controller."""

    version: Literal[1] = 1
    simulator: str
    simulator_settings: dict[str, Any]
    representation: str
    representation_settings: dict[str, Any]
    inputs: Annotated[int, Meta(ge=1, le=MOST)]
    outputs: Annotated[int, Meta(ge=1, le=MOST)]
    sensors: list[str]
    actuators: list[str]
    genome: bytes
    fitness: float  # in search
    # Whose sum fitness is, 1 for a score; 0: not known, in files of earlier versions.
    trials: Annotated[int, Meta(ge=0)] = 0
    run: str
    robot: RobotInterface | None = None  # as its simulator has it; None: it drives none
    held_out: HeldOut | None = None  # once the run's last generation is assessed

    def __repr__(self) -> str:
        """Return what it is, without its genome."""
        return (
            f"<Controller of {self.run}: {self.representation}, {len(self.genome):,} bytes, "
            f"fitness {self.in_search()}>"
        )

    def in_search(self) -> str:
        """Describe its fitness in search, as the mean of a trial if their number is known."""
        if not self.trials:
            return f"{per_trial(self.fitness)} (sum of its trials)"
        return with_trials(self.fitness, self.trials)

    def network(self) -> tuple["Representation", np.ndarray]:
        """Return the network, and the (P,) float32 parameters for its ``step``.

        Raises:
            ConfigError: its kind of network is not installed, or the genome does not fit it.
        """
        kind = plugins.load("representation", self.representation)
        settings = convert(
            self.representation_settings, kind.settings_type, "representation"
        )
        try:
            built: Representation = kind(settings, self.inputs, self.outputs)
            return built, built.parameters([self.genome])[0]
        except (ValueError, MemoryError) as error:
            # A file with absurd sizes raises MemoryError.
            raise ConfigError(f"the champion does not fit its network: {error}") from None

    def driver(self) -> "Driver":
        """Return the controller of one agent, to be called step by step; errors as ``network``.

        Example::

            driver = zswarm.read("runs/stadium").champion().driver()
            outputs = driver.act(observation)
        """
        return Driver(self)


class Driver:
    """The controller of one agent: a network and its state. Each agent needs its own.

    Attributes:
        inputs, outputs: lengths of an observation and of an action.
        network, parameters: as ``Controller.network`` returns them.
    """

    def __init__(self, controller: Controller) -> None:
        self.inputs, self.outputs = controller.inputs, controller.outputs
        self.network, self.parameters = controller.network()
        self._state = np.zeros(self.network.state_size, np.float32)

    def reset(self) -> None:
        """Reset the state, as at the start of a trial."""
        self._state[:] = 0

    def act(self, observation: "Sequence[float] | np.ndarray") -> np.ndarray:
        """Return the action for an observation, the same bits as in evolution.

        Args:
            observation: (inputs,) numbers, in the order of the controller's ``sensors``.

        Returns:
            (outputs,) float32, in the order of its ``actuators``.

        Raises:
            ValueError: another shape.
        """
        seen = np.ascontiguousarray(observation, np.float32)
        if seen.shape != (self.inputs,):
            raise ValueError(
                f"observation: expected shape ({self.inputs},), not {seen.shape}"
            )
        action = np.empty(self.outputs, np.float32)
        self.network.step(self.parameters, self._state, seen, action)
        return action


def load_controller(path: Path) -> Controller:
    """Load a champion from its file, or from the folder of a run.

    Raises:
        ConfigError: missing or damaged.
    """
    file = path / CHAMPION if path.is_dir() else path
    shown = clean(str(path))
    if file != path and not file.exists():
        if below := sorted(path.glob(f"*/{CHAMPION}")):
            run = clean(str(below[0].parent))
            raise ConfigError(
                f"{shown}: a folder of runs; expected one of them, such as {run}"
            )
        raise ConfigError(
            f"{shown}: cannot be read: no {CHAMPION} in it; expected a run that finished a "
            "generation"
        )
    if path.suffix == ".toml":
        raise ConfigError(
            f"{shown}: an experiment has no champion; expected the folder of its run, or a "
            f"{CHAMPION}"
        )
    try:
        return msgspec.msgpack.decode(file.read_bytes(), type=Controller)
    except OSError as error:
        raise ConfigError(
            f"{file}: cannot be read: {error.strerror}; expected a run's folder or its {CHAMPION}"
        ) from None
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ConfigError(
            f"{file}: damaged, or no controller: {clean(str(error))}"
        ) from None
