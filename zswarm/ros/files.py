"""The file route: a candidate goes into a ROS package as files, roslaunch plays it, its fitness is read from the robots' logs.

So the paper's FREVO used ROS (docs/ros-files.md). Which package, what its files are and which programs run is said by a manifest
of this machine; an experiment sets the parameters that the manifest offers, and chooses the fitness rule.
"""

import os
import shutil
import weakref
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path, PurePosixPath
from typing import Any, ClassVar

import msgspec
import numpy as np

from zswarm import manifests, plugins
from zswarm.controller import Controller
from zswarm.draws import Stream
from zswarm.errors import ConfigError, EvaluationError, UnknownPlugin
from zswarm.manifests import LaunchManifest, Place
from zswarm.ros import candidates, launches, logs, packages, parameters
from zswarm.ros.launches import Ended, Keeper
from zswarm.sims import foreign_messages as messages
from zswarm.sims.foreign import settings_struct
from zswarm.sims.simulator import HostingSimulator, Outcome, Turn
from zswarm.strict import convert

RULES = {
    "last-distance": "last-distance: minus the sum of the robots' last distances",
    "cpswarm-log": "cpswarm-log: by distance and time, 0 to 200",
    "command": "command: what the manifest's command says",
}
TYPES = {bool: "bool", int: "int", float: "float", str: "text"}
SEEDS = 2**31  # that ROS parameters have


class RosFiles(HostingSimulator):
    """One problem with its settings, played by roslaunch; ``simulator_class`` makes the class of each.

    Trials are whole: the package has the controllers. A copy of the package is this object's own.
    """

    name: ClassVar[str]
    manifest: ClassVar[LaunchManifest]
    package: ClassVar[Path]

    def __init__(self, settings: msgspec.Struct) -> None:
        super().__init__(settings)
        manifest = self.manifest
        self.inputs, self.outputs = manifest.inputs, manifest.outputs
        self.sensors, self.actuators = tuple(manifest.sensors), tuple(manifest.actuators)
        self.repeatable = manifest.repeatable and manifest.seed is not None
        robots = manifest.robots if isinstance(manifest.robots, int) else getattr(settings, manifest.robots)
        if not 1 <= robots <= messages.MAX_AGENTS:
            raise ConfigError(
                f"simulator {self.name!r}: {manifest.robots}: expected 1 to {messages.MAX_AGENTS} robots, not {robots}"
            )
        self.owners = (0,) * robots
        self._rule: str = settings.fitness  # type: ignore[attr-defined]  # a field that simulator_class adds
        self.metrics = () if self._rule == "command" else ("distance", "steps")
        self._parameters = [(place, getattr(settings, name)) for name, place in manifest.settings.items()]
        for name, place in manifest.settings.items():
            _check(f"simulator {self.name!r}: {name}", getattr(settings, name), place)
        self._copy: tuple[Keeper, Path] | None = None

    def host(self, kind: str, settings: Mapping[str, Any]) -> bool:
        """Take note of the network; all trials are played with it.

        Raises:
            ConfigError: its controllers have no such form as the manifest wants.
        """
        self._kind, self._network = kind, dict(settings)
        loaded = plugins.load("representation", kind)
        network = loaded(convert(settings, loaded.settings_type, "representation"), self.inputs, self.outputs)
        self._text(network.random(1, Stream(0))[0])
        return True

    def play_alone(self, genomes: Sequence[bytes], seed: int) -> Outcome:
        """Write the files, launch, and read the logs.

        Raises:
            EvaluationError: a program failed, or cannot be started; the text says which.
        """
        try:
            return self._play(genomes[0], seed)
        except EvaluationError as error:
            raise EvaluationError(f"simulator {self.name!r}, trial seed {seed}: {error}") from None

    def reset(self, seed: int) -> Turn:  # noqa: ARG002  of the contract
        """Turns there are none."""
        raise EvaluationError(f"simulator {self.name!r} plays whole trials, by roslaunch: they cannot be followed in turns")

    def step(self, actions: np.ndarray) -> Turn | None:  # noqa: ARG002  of the contract
        """See ``reset``."""
        raise EvaluationError(f"simulator {self.name!r} plays whole trials")

    def outcome(self) -> Outcome:
        """See ``reset``."""
        raise EvaluationError(f"simulator {self.name!r} plays whole trials")

    def _play(self, genome: bytes, seed: int) -> Outcome:
        keeper, package = self._copied()
        manifest = self.manifest
        results = package / manifest.logs
        shutil.rmtree(results, ignore_errors=True)
        results.mkdir(parents=True)
        environment = launches.environment(keeper.folder, package.parent)
        arguments = self._write(package, genome, seed)
        if manifest.controller.rebuild:
            command = _filled(manifest.controller.rebuild, package)
            _succeeded("rebuild", keeper.run(command, package, environment, manifest.controller.limit_s))
        launches.launch(keeper, package / manifest.launch, arguments, environment)
        if self._rule == "command":
            command = [*_filled(manifest.command, package), str(results)]
            ended = _succeeded("command", keeper.run(command, package, environment, manifest.command_limit_s))
            return Outcome([logs.given(ended.said)], [])
        robots = logs.read(results, len(self.owners))
        fitness = logs.fitness(self._rule, robots)
        known = [robot.distance for robot in robots if robot.distance is not None]
        return Outcome([fitness], [sum(known) / len(known) if known else np.nan, max(robot.steps for robot in robots)])

    def _copied(self) -> tuple[Keeper, Path]:
        """The keeper, and the copy of the package in its folder; made by the first trial."""
        if self._copy is None:
            keeper = Keeper()
            weakref.finalize(self, keeper.close)
            (keeper.folder / "packages").mkdir()
            self._copy = keeper, packages.copy(self.package, keeper.folder / "packages")
        return self._copy

    def _write(self, package: Path, genome: bytes, seed: int) -> dict[str, str]:
        """Write parameters and candidate; the arguments of roslaunch."""
        manifest = self.manifest
        arguments = dict(zip(manifest.arguments, _filled(list(manifest.arguments.values()), package), strict=True))
        files = {
            name: {
                key: value.replace("{package}", str(package)) if isinstance(value, str) else value
                for key, value in values.items()
            }
            for name, values in manifest.parameters.items()
        }
        placed: list[tuple[Place, Any]] = list(self._parameters)
        if manifest.seed is not None:
            placed.append((manifest.seed, seed % SEEDS))
        for place, value in placed:
            if place.argument is not None:
                arguments[place.argument] = value if isinstance(value, str) else parameters.value(place.argument, value)
            elif place.file is not None and place.key is not None:
                files.setdefault(place.file, {})[place.key] = value
        for name, values in files.items():
            packages.write(package / name, parameters.text(values))
        packages.write(package / manifest.controller.file, self._text(genome))
        return arguments

    def _text(self, genome: bytes) -> str:
        """The candidate's file."""
        return candidates.FORMS[self.manifest.controller.form](self._controller(genome))

    def _controller(self, genome: bytes) -> Controller:
        return Controller(
            simulator=self.name, simulator_settings=msgspec.to_builtins(self.settings), representation=self._kind,
            representation_settings=self._network, inputs=self.inputs, outputs=self.outputs, sensors=list(self.sensors),
            actuators=list(self.actuators), genome=genome, fitness=0.0, run=candidates.NAME,
        )  # fmt: skip


@cache
def simulator_class(name: str, path: Path) -> type[RosFiles]:
    """The class of a launch file's simulator.

    Raises:
        UnknownPlugin: the manifest or the package cannot be used; the text says why.
    """
    try:
        manifest = manifests.read(path)
        assert isinstance(manifest, LaunchManifest)  # noqa: S101  what plugins saw
        package = packages.find(manifest.package, path.parent)
        _check_manifest(manifest, package)
        settings_type = settings_struct([*_offered(manifest), _fitness(manifest)], "settings:")
    except ConfigError as error:
        raise UnknownPlugin(f"simulator {name!r}: {error}") from None
    said = {
        "name": name, "manifest": manifest, "package": package, "settings_type": settings_type,
        "__doc__": manifest.description, "__module__": __name__,
    }  # fmt: skip
    return type(name, (RosFiles,), said)


def _offered(manifest: LaunchManifest) -> list[messages.Setting]:
    return [
        messages.Setting(
            name=name, type=TYPES[type(one.default)], default=one.default, description=one.description,  # type: ignore[arg-type]  # one of them
            minimum=one.minimum, maximum=one.maximum, choices=one.choices,
        )
        for name, one in manifest.settings.items()
    ]  # fmt: skip


def _fitness(manifest: LaunchManifest) -> messages.Setting:
    rules = [rule for rule in RULES if rule != "command" or manifest.command]
    meaning = "; ".join(RULES[rule] for rule in rules)
    return messages.Setting(name="fitness", type="text", default=manifest.fitness, choices=rules, description=meaning)


def _check_manifest(manifest: LaunchManifest, package: Path) -> None:
    if not (package / manifest.launch).is_file():
        raise ConfigError(f"launch: package {manifest.package!r} has no file {manifest.launch}")
    text = (package / manifest.launch).read_text(encoding="utf-8", errors="replace")
    if "required=" not in text and "<include" not in text:
        raise ConfigError(
            f'launch: {manifest.launch} has no node with required="true"; expected one that ends when the trial is over: then '
            "roslaunch ends the others, and itself"
        )
    for what, names, count in (
        ("sensors", manifest.sensors, manifest.inputs),
        ("actuators", manifest.actuators, manifest.outputs),
    ):
        if names and len(names) != count:
            raise ConfigError(f"{what}: expected {count} names or none, not {len(names)}")
    robots = manifest.robots
    if isinstance(robots, str) and type(getattr(manifest.settings.get(robots), "default", None)) is not int:
        raise ConfigError(f"robots: expected a number, or the name of a setting with one, not {robots!r}")
    if manifest.fitness == "command" and not manifest.command:
        raise ConfigError("fitness: command: expected the key command, a program with its arguments")
    if not PurePosixPath(manifest.logs).parts:
        raise ConfigError("logs: expected a folder in the package, which is emptied before each trial")
    if manifest.controller.form == "c99" and not manifest.controller.rebuild:
        raise ConfigError("controller: c99: expected the key rebuild, a program with its arguments")
    for file, values in manifest.parameters.items():
        try:
            parameters.text(values)
        except ValueError as error:
            raise ConfigError(f"parameters: {file}: {error}") from None


def _check(where: str, value: Any, place: Place) -> None:
    """See that the value of a setting can go to its place.

    Raises:
        ConfigError: it cannot. A text comes from an experiment, perhaps over the network: roslaunch must not evaluate it.
    """
    if isinstance(value, str) and ("$(" in value or not value.isprintable()):
        raise ConfigError(f"{where}: expected a text without $( and control characters, not {value[:60]!r}")
    try:
        parameters.value(place.argument or place.key or "", value)
    except ValueError as error:
        raise ConfigError(f"{where}: {error}") from None


def _filled(command: Sequence[str], package: Path) -> list[str]:
    """With the folder of the package where {package} stands."""
    return [part.replace("{package}", os.fspath(package)) for part in command]


def _succeeded(what: str, ended: Ended) -> Ended:
    if ended.code != 0:
        raise EvaluationError(f"the {what} {launches.how_it_ended(ended.code)}{launches.last_words(ended.said)}")
    return ended
