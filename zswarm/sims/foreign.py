"""A simulator in any language: a program that a manifest names, beside each slot as its child (docs/foreign.md).

With a network that it knows the program plays whole trials; otherwise it is asked for turns, and told what the agents do.
"""

import contextlib
import keyword
import weakref
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import msgspec
import numpy as np
from msgspec import Meta

from zswarm import manifests
from zswarm.errors import ConfigError, EvaluationError, UnknownPlugin
from zswarm.manifests import Manifest
from zswarm.protocol.codec import clean
from zswarm.sims import foreign_messages as messages
from zswarm.sims.foreign_program import START_S, Program
from zswarm.sims.simulator import HostingSimulator, Outcome, Turn

TYPES = {"int": int, "float": float, "bool": bool, "text": str}


class ProgramError(Exception):
    """What the program of a simulator said that it cannot do, or said wrongly; it can go on."""


class Foreign(HostingSimulator):
    """One problem with its settings, played by a program; ``simulator_class`` makes the class of each.

    A trial takes a program that nobody uses, sets it up if it was set up otherwise, and leaves it to the next one.
    """

    name: ClassVar[str]
    manifest: ClassVar[Manifest]
    folder: ClassVar[Path]
    spare: ClassVar[list[Program]]  # one that nobody uses, at most

    def __init__(self, settings: msgspec.Struct) -> None:
        super().__init__(settings)
        self._setup = messages.Setup(settings=msgspec.to_builtins(settings), network=None)
        self._taken: list[Program] = []  # by the trial under way
        self._where = f"simulator {self.name!r}"  # and the seed of that trial
        weakref.finalize(self, _leave, self._taken, self.spare).atexit = False
        self._ready = ready = self._tell_setup()
        _leave(self._taken, self.spare)
        if max(ready.owners) >= ready.participants:
            raise self._refusal(f"owners: expected participants 0 to {ready.participants - 1}, not {max(ready.owners)}")
        self.inputs, self.outputs = ready.inputs, ready.outputs
        self.owners, self.participants = tuple(ready.owners), ready.participants
        self.metrics = tuple(map(clean, ready.metrics))
        self.sensors, self.actuators = tuple(map(clean, ready.sensors)), tuple(map(clean, ready.actuators))
        for what, names, count in (("sensors", self.sensors, self.inputs), ("actuators", self.actuators, self.outputs)):
            if names and len(names) != count:
                raise self._refusal(f"{what}: expected {count} names or none, not {len(names)}")

    def host(self, kind: str, settings: Mapping[str, Any]) -> bool:
        """Set the program up with a network; whether it decides for that itself."""
        alone = self._setup
        self._setup = msgspec.structs.replace(alone, network=messages.Network(kind=kind, settings=dict(settings)))
        ready = self._tell_setup()
        _leave(self._taken, self.spare)
        if msgspec.structs.replace(ready, hosts=False) != msgspec.structs.replace(self._ready, hosts=False):
            raise self._refusal("ready must say the same whatever the network, but for hosts")
        if not ready.hosts:
            self._setup = alone
        return ready.hosts

    def fixed_seeds(self, trials: int) -> Sequence[int] | None:
        """One after another from the first, where the program says which that is."""
        first = self._ready.first_seed
        return None if first is None else range(first, first + trials)

    def play_alone(self, genomes: Sequence[bytes], seed: int) -> Outcome:
        """See ``HostingSimulator.play_alone``."""
        self._begin(seed)
        return self._ended(self._ask(messages.Evaluate(seed=seed, genomes=list(genomes)), messages.End))

    def reset(self, seed: int) -> Turn:
        """Begin a trial in turns."""
        self._begin(seed)
        turn = self._turn(self._ask(messages.Reset(seed=seed), messages.Turn))
        assert turn is not None  # noqa: S101  an end is not among the answers
        return turn

    def step(self, actions: np.ndarray) -> Turn | None:
        """Tell what the agents do."""
        raw = np.ascontiguousarray(actions, "<f4").tobytes()
        return self._turn(self._ask(messages.Actions(actions=raw), messages.Turn, messages.End))

    def outcome(self) -> Outcome:
        """What the program said at the end."""
        return self._outcome

    def _turn(self, said: messages.Said) -> Turn | None:
        if isinstance(said, messages.End):
            self._outcome = self._ended(said)
            return None
        assert isinstance(said, messages.Turn)  # noqa: S101  one of the expected answers
        if max(said.agents) >= len(self.owners):
            raise self._wrong(f"turn: agents: expected 0 to {len(self.owners) - 1}, not {max(said.agents)}")
        count, expected = len(said.observations), 4 * len(said.agents) * self.inputs
        if count != expected:
            raise self._wrong(
                f"turn: observations: expected {expected} bytes ({len(said.agents)} agents, {self.inputs} float32 each), "
                f"not {count}"
            )
        observations = np.frombuffer(said.observations, "<f4").copy()  # kernels take what may be written
        return Turn(said.agents, observations.reshape(-1, self.inputs))

    def _ended(self, said: messages.Said) -> Outcome:
        assert isinstance(said, messages.End)  # noqa: S101  one of the expected answers
        _leave(self._taken, self.spare)
        return Outcome(said.fitness, said.metrics)

    def _begin(self, seed: int) -> None:
        self._where = f"simulator {self.name!r}, trial seed {seed}"
        if self._program().set_up is not self._setup:
            self._tell_setup()

    def _ask(self, message: messages.Asked, *expected: type[messages.Said]) -> messages.Said:
        """The program's answer to what it is asked in a trial."""
        program = self._program()
        with self._named():
            said = program.ask(message, (*expected, messages.Error))
        if isinstance(said, messages.Error):
            raise self._wrong(clean(said.text))
        return said

    def _tell_setup(self) -> messages.Ready:
        program = self._program()
        with self._named():
            said = program.ask(self._setup, (messages.Ready, messages.Error), START_S)
        if isinstance(said, messages.Error):
            raise self._refusal(clean(said.text))
        assert isinstance(said, messages.Ready)  # noqa: S101  one of the expected answers
        self._program().set_up = self._setup
        return said

    def _program(self) -> Program:
        """That of the trial under way, or another one."""
        if not self._taken or not self._taken[0].open:
            while self.spare and not self.spare[0].is_there():
                self.spare.pop().close()
            with self._named():
                self._taken[:] = [self.spare.pop() if self.spare else Program(self.manifest, self.folder)]
        return self._taken[0]

    @contextlib.contextmanager
    def _named(self) -> Iterator[None]:
        """What goes wrong with the program is told with the simulator and the trial."""
        try:
            yield
        except (ConfigError, EvaluationError) as error:
            raise type(error)(f"{self._where}: {error}") from None

    def _wrong(self, why: str) -> ProgramError:
        """The trial is over: at the next one the program gives up what it still knows of this one."""
        _leave(self._taken, self.spare)
        return ProgramError(why)

    def _refusal(self, why: str) -> ConfigError:
        _leave(self._taken, self.spare)
        return ConfigError(f"simulator {self.name!r}: {why}")


@cache
def simulator_class(name: str, manifest: Path) -> type[Foreign]:
    """The class of a program's simulator; the program is started, to hear which settings it has.

    Raises:
        UnknownPlugin: the manifest or the program cannot be used; the text says why.
    """
    try:
        read = manifests.read(manifest)
        assert isinstance(read, Manifest)  # noqa: S101  what plugins saw
        program = Program(read, manifest.parent)
        try:
            settings_type = settings_struct(program.hello.settings, "hello: setting")
        except ConfigError:
            program.close()
            raise
    except (ConfigError, EvaluationError) as error:
        raise UnknownPlugin(f"simulator {name!r}: {error}") from None
    said = {
        "name": name, "manifest": read, "folder": manifest.parent, "spare": [program], "settings_type": settings_type,
        "__doc__": program.hello.description or read.description, "__module__": __name__,
    }  # fmt: skip
    return type(name, (Foreign,), said)


def settings_struct(settings: Sequence[messages.Setting], where: str) -> type[msgspec.Struct]:
    """A struct of the settings that a program has.

    Args:
        where: they are listed, for an error.

    Raises:
        ConfigError: one of them is impossible.
    """
    fields: list[tuple[str, Any, Any]] = []
    for setting in settings:
        named = f"{where} {setting.name!r}"
        if keyword.iskeyword(setting.name) or setting.name in {field[0] for field in fields}:
            raise ConfigError(f"{named}: a keyword, or there twice")
        if setting.choices and setting.type != "text":
            raise ConfigError(f"{named}: choices are of a text")
        if (setting.minimum, setting.maximum) != (None, None) and setting.type not in ("int", "float"):
            raise ConfigError(f"{named}: minimum and maximum are of a number")
        kind: Any = Literal[tuple(setting.choices)] if setting.choices else TYPES[setting.type]
        meaning = Meta(ge=setting.minimum, le=setting.maximum, description=clean(setting.description))
        try:
            default = msgspec.convert(setting.default, Annotated[kind, meaning])
        except (msgspec.ValidationError, TypeError, ValueError) as error:
            raise ConfigError(f"{named}: default: {error}") from None
        fields.append((setting.name, Annotated[kind, meaning], default))
    return msgspec.defstruct("Settings", fields, frozen=True, kw_only=True, forbid_unknown_fields=True, module=__name__)


def _leave(taken: list[Program], spare: list[Program]) -> None:
    """Keep the program of a trial for the next one, if there is none yet."""
    while taken:
        program = taken.pop()
        if not spare and program.open:
            spare.append(program)
        else:
            program.close()
