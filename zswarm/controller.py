"""A run's champion as a file that other programs read: ``champion.zsc``, in docs/record.md."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import msgspec
import numpy as np

from zswarm import plugins
from zswarm.errors import ConfigError
from zswarm.protocol import codec
from zswarm.strict import convert

if TYPE_CHECKING:  # it brings the compiler
    from zswarm.nets.representation import Representation

CHAMPION = "champion.zsc"


class Controller(msgspec.Struct, frozen=True, kw_only=True, tag="zswarm-controller", tag_field="format"):
    """The file ``champion.zsc``: all that another program needs to run the controller."""

    version: Literal[1] = 1
    simulator: str
    simulator_settings: dict[str, Any]
    representation: str
    representation_settings: dict[str, Any]
    inputs: int
    outputs: int
    sensors: list[str]
    actuators: list[str]
    genome: bytes
    fitness: float
    run: str

    def network(self) -> tuple["Representation", np.ndarray]:
        """Its network, and the numbers that the network's ``step`` reads: (P,) float32.

        Raises:
            ConfigError: its kind of network is not installed, or its genome does not fit it.
        """
        kind = plugins.load("representation", self.representation)
        settings = convert(self.representation_settings, kind.settings_type, "representation")
        try:
            built: Representation = kind(settings, self.inputs, self.outputs)
            return built, built.parameters([self.genome])[0]
        except ValueError as error:
            raise ConfigError(f"the champion does not fit its network: {error}") from None

    def driver(self) -> "Driver":
        """The controller of one agent, to be asked step by step.

        Raises:
            ConfigError: its kind of network is not installed, or its genome does not fit it.

        Example::

            driver = zswarm.read("runs/stadium").champion().driver()
            outputs = driver.act(observation)
        """
        return Driver(self)


class Driver:
    """A controller at work: one agent's network with its state. Each agent needs its own.

    Attributes:
        inputs, outputs: numbers of an observation, and of what is decided.
        network, parameters: as ``Controller.network`` gives them.
    """

    def __init__(self, controller: Controller) -> None:
        self.inputs, self.outputs = controller.inputs, controller.outputs
        self.network, self.parameters = controller.network()
        self._state = np.zeros(self.network.state_size, np.float32)

    def reset(self) -> None:
        """Forget all of before, as at the start of a trial."""
        self._state[:] = 0

    def act(self, observation: "Sequence[float] | np.ndarray") -> np.ndarray:
        """What the controller decides, the same bits as in evolution.

        Args:
            observation: (inputs,) numbers, in the order of the controller's ``sensors``.

        Returns:
            (outputs,) float32, in the order of its ``actuators``.

        Raises:
            ValueError: another shape.
        """
        seen = np.ascontiguousarray(observation, np.float32)
        if seen.shape != (self.inputs,):
            raise ValueError(f"observation: expected shape ({self.inputs},), not {seen.shape}")
        decided = np.empty(self.outputs, np.float32)
        self.network.step(self.parameters, self._state, seen, decided)
        return decided


def load_controller(path: Path) -> Controller:
    """A champion's file, or that of a run's folder.

    Raises:
        ConfigError: missing or damaged.
    """
    file = path / CHAMPION if path.is_dir() else path
    shown = codec.clean(str(path))
    if file != path and not file.exists():
        if below := sorted(path.glob(f"*/{CHAMPION}")):
            one = codec.clean(str(below[0].parent))
            raise ConfigError(f"{shown}: a folder of runs; expected one of them, such as {one}")
        raise ConfigError(f"{shown}: cannot be read: no {CHAMPION} in it; expected a run that finished a generation")
    if path.suffix == ".toml":
        raise ConfigError(f"{shown}: an experiment has no champion; expected the folder of its run, or a {CHAMPION}")
    try:
        return msgspec.msgpack.decode(file.read_bytes(), type=Controller)
    except OSError as error:
        raise ConfigError(f"{file}: cannot be read: {error.strerror}; expected a run's folder or its {CHAMPION}") from None
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ConfigError(f"{file}: damaged, or no controller: {codec.clean(str(error))}") from None
