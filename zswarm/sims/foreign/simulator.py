"""A simulator in any language: a program named by a manifest, a child of each slot.

A program that knows the network plays whole trials. Otherwise it plays in turns (docs/foreign.md).
"""

import contextlib
import keyword
import weakref
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, TypeVar

import msgspec
import numpy as np
from msgspec import Meta

from zswarm.errors import ConfigError, EvaluationError, UnknownPlugin
from zswarm.plugins import manifests
from zswarm.plugins.manifests import Manifest
from zswarm.sims.foreign import messages
from zswarm.sims.foreign.program import START_S, Program
from zswarm.sims.simulator import HostingSimulator, Outcome, Turn
from zswarm.system.text import clean

TYPES = {"int": int, "float": float, "bool": bool, "text": str}

R = TypeVar("R", bound=messages.Reply)


class ProgramError(Exception):
    """A simulator's program reported an error, or sent wrong values; it can continue."""


class Foreign(HostingSimulator):
    """One problem with its settings, played by a program; ``simulator_class`` creates its class.

    A trial takes an idle program, sets it up unless it is, and returns it at the end.
    """

    name: ClassVar[str]
    manifest: ClassVar[Manifest]
    folder: ClassVar[Path]
    spare: ClassVar[list[Program]]  # at most one idle program

    def __init__(self, settings: msgspec.Struct) -> None:
        super().__init__(settings)
        self._setup = messages.Setup(settings=msgspec.to_builtins(settings), network=None)
        self._taken: list[Program] = []  # by the current trial
        self._where = f"simulator {self.name!r}"  # and the seed of the current trial
        weakref.finalize(self, _release, self._taken, self.spare).atexit = False
        self._ready = ready = self._set_up()
        _release(self._taken, self.spare)
        last = ready.participants - 1
        if max(ready.owners) > last:
            text = f"expected participants 0 to {last}, not {max(ready.owners)}"
            raise self._refusal(f"owners: {text}")
        self.inputs = ready.inputs
        self.outputs = ready.outputs
        self.owners = tuple(ready.owners)
        self.participants = ready.participants
        self.metrics = tuple(map(clean, ready.metrics))
        self.sensors = self._names("sensors", ready.sensors, self.inputs)
        self.actuators = self._names("actuators", ready.actuators, self.outputs)

    def _names(self, key: str, names: Sequence[str], count: int) -> tuple[str, ...]:
        if len(names) not in (0, count):
            raise self._refusal(
                f"{key}: expected {count} names or none, not {len(names)}"
            )
        return tuple(map(clean, names))

    def host(self, kind: str, settings: Mapping[str, Any]) -> bool:
        """Set the program up with a network; return whether it decides for that itself."""
        alone = self._setup
        network = messages.Network(kind=kind, settings=dict(settings))
        self._setup = msgspec.structs.replace(alone, network=network)
        ready = self._set_up()
        _release(self._taken, self.spare)
        if msgspec.structs.replace(ready, hosts=self._ready.hosts) != self._ready:
            raise self._refusal(
                "ready must be the same for each network, except for hosts"
            )
        if not ready.hosts:
            self._setup = alone
        return ready.hosts

    def fixed_seeds(self, trials: int) -> Sequence[int] | None:
        """Return consecutive seeds if the program states the first one."""
        first = self._ready.first_seed
        return None if first is None else range(first, first + trials)

    def play_alone(self, genomes: Sequence[bytes], seed: int) -> Outcome:
        """See ``HostingSimulator``."""
        self._begin(seed)
        message = messages.EvaluateTrials(seed=seed, genomes=list(genomes))
        return self._ended(self._ask(message, messages.End))

    def reset(self, seed: int) -> Turn:
        """Begin a trial in turns."""
        self._begin(seed)
        return self._turn(self._ask(messages.ResetTrial(seed=seed), messages.TurnMessage))

    def step(self, actions: np.ndarray) -> Turn | None:
        """Send the actions of the agents."""
        message = messages.Actions(actions=np.ascontiguousarray(actions, "<f4").tobytes())
        reply = self._ask(message, messages.TurnMessage, messages.End)
        if isinstance(reply, messages.TurnMessage):
            return self._turn(reply)
        assert isinstance(reply, messages.End)  # noqa: S101  by ``_ask``
        self._outcome = self._ended(reply)
        return None

    def outcome(self) -> Outcome:
        """Return the outcome that the program sent at the end."""
        return self._outcome

    def _turn(self, message: messages.TurnMessage) -> Turn:
        agents = message.agents
        last = len(self.owners) - 1
        if max(agents) > last:
            raise self._wrong(f"turn: agents: expected 0 to {last}, not {max(agents)}")
        count = len(message.observations)
        expected = 4 * len(agents) * self.inputs
        if count != expected:
            text = f"{expected} bytes ({len(agents)} agents, {self.inputs} float32 each)"
            raise self._wrong(f"turn: observations: expected {text}, not {count}")
        # A copy, for kernels take writable arrays.
        observations = np.frombuffer(message.observations, "<f4").copy()
        return Turn(agents, observations.reshape(-1, self.inputs))

    def _ended(self, message: messages.End) -> Outcome:
        _release(self._taken, self.spare)
        return Outcome(message.fitness, message.metrics)

    def _begin(self, seed: int) -> None:
        self._where = f"simulator {self.name!r}, trial seed {seed}"
        if self._program().set_up is not self._setup:
            self._set_up()

    def _ask(self, message: messages.Request, *expected: type[R]) -> R:
        """Return the program's answer to a message of a trial; raise an error that it sends."""
        reply = self._answer(message, expected)
        if isinstance(reply, messages.Error):
            raise self._wrong(clean(reply.text))
        return reply

    def _set_up(self) -> messages.ProgramReady:
        reply = self._answer(self._setup, (messages.ProgramReady,), START_S)
        if isinstance(reply, messages.Error):
            raise self._refusal(clean(reply.text))
        self._program().set_up = self._setup
        return reply

    def _answer(
        self,
        message: messages.Request,
        expected: tuple[type[R], ...],
        limit_s: float = 0.0,
    ) -> R | messages.Error:
        program = self._program()
        with self._located():
            return program.ask(message, expected, limit_s)

    def _program(self) -> Program:
        """Return the program of the current trial, or another one."""
        if not self._taken or not self._taken[0].open:
            while self.spare and not self.spare[0].is_there():
                self.spare.pop().close()
            with self._located():
                program = (
                    self.spare.pop()
                    if self.spare
                    else Program(self.manifest, self.folder)
                )
            self._taken[:] = [program]
        return self._taken[0]

    @contextlib.contextmanager
    def _located(self) -> Iterator[None]:
        """Prepend simulator and trial to the program's errors."""
        try:
            yield
        except (ConfigError, EvaluationError) as error:
            raise type(error)(f"{self._where}: {error}") from None

    def _wrong(self, why: str) -> ProgramError:
        """Return an error that ends the trial; the program forgets it when the next one begins."""
        _release(self._taken, self.spare)
        return ProgramError(why)

    def _refusal(self, why: str) -> ConfigError:
        _release(self._taken, self.spare)
        return ConfigError(f"simulator {self.name!r}: {why}")


@cache
def simulator_class(name: str, manifest: Path) -> type[Foreign]:
    """Return the class of a program's simulator; start the program to learn its settings.

    Raises:
        UnknownPlugin: the manifest or the program cannot be used; the text says why.
    """
    try:
        read = manifests.read(manifest)
        assert isinstance(read, Manifest)  # noqa: S101  checked by plugins
        program = Program(read, manifest.parent)
        try:
            settings_type = settings_struct(program.hello.settings, "hello: setting")
        except ConfigError:
            program.close()
            raise
    except (ConfigError, EvaluationError) as error:
        raise UnknownPlugin(f"simulator {name!r}: {error}") from None
    members = {
        "name": name,
        "manifest": read,
        "folder": manifest.parent,
        "spare": [program],
        "settings_type": settings_type,
        "__doc__": program.hello.description or read.description,
        "__module__": __name__,
    }
    return type(name, (Foreign,), members)


def settings_struct(
    entries: Sequence[messages.SettingEntry], where: str
) -> type[msgspec.Struct]:
    """Return a struct of a program's settings.

    Args:
        entries: one per setting.
        where: begins an error message.

    Raises:
        ConfigError: one of the settings is impossible.
    """
    fields: dict[str, tuple[str, Any, Any]] = {}
    for entry in entries:
        at = f"{where} {entry.name!r}"
        if keyword.iskeyword(entry.name) or entry.name in fields:
            raise ConfigError(f"{at}: a keyword, or there twice")
        if entry.choices and entry.type != "text":
            raise ConfigError(f"{at}: choices are of a text")
        is_bounded = (entry.minimum, entry.maximum) != (None, None)
        if is_bounded and entry.type not in ("int", "float"):
            raise ConfigError(f"{at}: minimum and maximum are of a number")
        kind: Any = Literal[tuple(entry.choices)] if entry.choices else TYPES[entry.type]
        meta = Meta(
            ge=entry.minimum, le=entry.maximum, description=clean(entry.description)
        )
        try:
            default = msgspec.convert(entry.default, Annotated[kind, meta])
        except (msgspec.ValidationError, TypeError, ValueError) as error:
            raise ConfigError(f"{at}: default: {error}") from None
        fields[entry.name] = (entry.name, Annotated[kind, meta], default)
    return msgspec.defstruct(
        "Settings",
        fields.values(),
        frozen=True,
        kw_only=True,
        forbid_unknown_fields=True,
        module=__name__,
    )


def _release(taken: list[Program], spare: list[Program]) -> None:
    """Return the program of a trial for the next one, or close it if there is an idle one."""
    while taken:
        program = taken.pop()
        if not spare and program.open:
            spare.append(program)
        else:
            program.close()
