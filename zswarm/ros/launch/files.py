"""The file route: a candidate is written into a ROS package, roslaunch plays it, logs are read.

The paper's FREVO used ROS like this (docs/ros-files.md). A manifest on this machine names the
package, its files and programs; an experiment sets the parameters that the manifest offers, and
chooses the fitness rule.
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

from zswarm.champion.controller import Controller
from zswarm.config.decode import convert
from zswarm.errors import ConfigError, EvaluationError, UnknownPlugin
from zswarm.kernels.portable import PI
from zswarm.kernels.random import Stream
from zswarm.kernels.sums import mean
from zswarm.plugins import manifests
from zswarm.plugins import registry as plugins
from zswarm.plugins.manifests import LaunchManifest, LaunchTarget
from zswarm.ros.launch import controller_files, logs, packages, parameters, roslaunch
from zswarm.ros.launch.roslaunch import Supervisor
from zswarm.sims.foreign import messages
from zswarm.sims.foreign.simulator import settings_struct
from zswarm.sims.simulator import HostingSimulator, Outcome, RobotInterface, Turn
from zswarm.system.processes import ending

RULES = {
    "last-distance": "last-distance: minus the sum of the robots' last distances",
    "cpswarm-log": "cpswarm-log: by distance and time, 0 to 200",
    "command": "command: the output of the manifest's command",
}
TYPES = {bool: "bool", int: "int", float: "float", str: "text"}
OVERTIME = "took longer than its limit and was ended"
SEEDS = 2**31  # that ROS parameters can hold


class RosFiles(HostingSimulator):
    """One problem with its settings, played by roslaunch; ``simulator_class`` makes subclasses.

    Trials are played whole: the package has the controllers. Each object has a copy of the package.
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
        robots = manifest.robots
        if isinstance(robots, str):
            robots = int(getattr(settings, robots))
        if not 1 <= robots <= messages.MAX_AGENTS:
            raise ConfigError(
                f"simulator {self.name!r}: {manifest.robots}: "
                f"expected 1 to {messages.MAX_AGENTS} robots, not {robots}"
            )
        self.owners = (0,) * robots
        self.robot = _interface(manifest)
        self._rule: str = settings.fitness  # type: ignore[attr-defined]  # of simulator_class
        self.metrics = () if self._rule == "command" else ("distance", "steps")
        self._targets: list[tuple[LaunchTarget, Any]] = []
        for name, target in manifest.settings.items():
            value = getattr(settings, name)
            _check(f"simulator {self.name!r}: {name}", value, target)
            self._targets.append((target, value))
        self._copy: tuple[Supervisor, Path] | None = None

    def host(self, kind: str, settings: Mapping[str, Any]) -> bool:
        """Take the network that all trials are played with."""
        self._kind, self._network = kind, dict(settings)
        loaded = plugins.load("representation", kind)
        complete = convert(settings, loaded.settings_type, "representation")
        network = loaded(complete, self.inputs, self.outputs)
        self._controller_files(network.random(1, Stream(0))[0])
        return True

    def play_alone(self, genomes: Sequence[bytes], seed: int) -> Outcome:
        """Write the files, launch, and read the logs."""
        try:
            return self._play(genomes[0], seed)
        except EvaluationError as error:
            raise EvaluationError(
                f"simulator {self.name!r}, trial seed {seed}: {error}"
            ) from None

    def reset(self, seed: int) -> Turn:  # noqa: ARG002  of the contract
        """Refuse: trials have no turns."""
        raise EvaluationError(
            f"simulator {self.name!r} plays whole trials, by roslaunch: "
            "they cannot be followed in turns"
        )

    def step(self, actions: np.ndarray) -> Turn | None:  # noqa: ARG002  of the contract
        """Refuse, as ``reset``."""
        raise EvaluationError(f"simulator {self.name!r} plays whole trials")

    def outcome(self) -> Outcome:
        """Refuse, as ``reset``."""
        raise EvaluationError(f"simulator {self.name!r} plays whole trials")

    def _play(self, genome: bytes, seed: int) -> Outcome:
        supervisor, package = self._copied()
        manifest = self.manifest
        environment = roslaunch.environment(supervisor.folder, package.parent)
        results = package / manifest.logs
        shutil.rmtree(results, ignore_errors=True)
        results.mkdir(parents=True)

        def run(what: str, command: list[str], limit_s: float) -> str:
            ended = supervisor.run(command, package, environment, limit_s)
            if ended.code != 0:
                raise EvaluationError(f"the {what} {ending(*ended, OVERTIME)}")
            return ended.output

        arguments = self._write(package, genome, seed)
        if rebuild := _filled(manifest.controller.rebuild, package):
            run("rebuild", rebuild, manifest.controller.limit_s)
        roslaunch.launch(supervisor, package / manifest.launch, arguments, environment)
        if self._rule == "command":
            command = [*_filled(manifest.command, package), str(results)]
            return Outcome(
                [logs.given(run("command", command, manifest.command_limit_s))], []
            )
        robots = logs.read(results, len(self.owners))
        fitness = logs.fitness(self._rule, robots)
        known = [robot.distance for robot in robots if robot.distance is not None]
        distance = mean(np.array(known, np.float64))
        return Outcome([fitness], [distance, max(robot.steps for robot in robots)])

    def _copied(self) -> tuple[Supervisor, Path]:
        """Return the supervisor, and the copy of the package; the first trial makes them."""
        if self._copy is None:
            supervisor = Supervisor()
            weakref.finalize(self, supervisor.close)
            folder = supervisor.folder / "packages"
            folder.mkdir()
            self._copy = supervisor, packages.copy(self.package, folder)
        return self._copy

    def _write(self, package: Path, genome: bytes, seed: int) -> dict[str, str]:
        """Write parameters and candidate; return the arguments of roslaunch."""
        manifest = self.manifest
        arguments = {
            name: _fill(text, package) for name, text in manifest.arguments.items()
        }
        files = {
            name: {key: _fill(value, package) for key, value in values.items()}
            for name, values in manifest.parameters.items()
        }
        targets = list(self._targets)
        if manifest.seed is not None:
            targets.append((manifest.seed, seed % SEEDS))
        for target, value in targets:
            name = target.argument
            if name is not None:
                is_text = isinstance(value, str)
                arguments[name] = value if is_text else parameters.value(name, value)
            elif target.file is not None and target.key is not None:
                files.setdefault(target.file, {})[target.key] = value
        for file, values in files.items():
            packages.write(package / file, parameters.text(values))
        for file, text in self._controller_files(genome).items():
            packages.write(package / file, text)
        return arguments

    def _controller_files(self, genome: bytes) -> dict[str, str]:
        controller = Controller(
            simulator=self.name,
            simulator_settings=msgspec.to_builtins(self.settings),
            representation=self._kind,
            representation_settings=self._network,
            inputs=self.inputs,
            outputs=self.outputs,
            sensors=list(self.sensors),
            actuators=list(self.actuators),
            genome=genome,
            fitness=0.0,
            run=controller_files.NAME,
        )
        kind = self.manifest.controller
        return controller_files.written(controller, kind.form, kind.file)


@cache
def simulator_class(name: str, path: Path) -> type[RosFiles]:
    """Return the class of a launch file's simulator."""
    try:
        manifest = manifests.read(path)
        assert isinstance(manifest, LaunchManifest)  # noqa: S101  checked by plugins
        package = packages.find(manifest.package, path.parent)
        _check_launch(manifest, package)
        _check_manifest(manifest)
        settings_type = settings_struct(_settings(manifest), "settings:")
    except ConfigError as error:
        raise UnknownPlugin(f"simulator {name!r}: {error}") from None
    attributes = {
        "name": name,
        "manifest": manifest,
        "package": package,
        "settings_type": settings_type,
        "__doc__": manifest.description,
        "__module__": __name__,
    }
    return type(name, (RosFiles,), attributes)


def _interface(manifest: LaunchManifest) -> RobotInterface | None:
    """Return the robot that a manifest describes."""
    if (robot := manifest.robot) is None:
        return None
    fields = msgspec.structs.asdict(robot) | {
        "view": robot.view * PI / 180,
        "sectors": manifest.inputs - 2,
        "targets": tuple(robot.targets),
    }
    return RobotInterface(**fields)


def _settings(manifest: LaunchManifest) -> list[messages.SettingEntry]:
    """Return the settings that a manifest offers, and the fitness rule."""
    shared = ("default", "description", "minimum", "maximum", "choices")
    offered = [
        messages.SettingEntry(
            name=name,
            type=TYPES[type(one.default)],  # type: ignore[arg-type]  # one of them
            **{field: getattr(one, field) for field in shared},
        )
        for name, one in manifest.settings.items()
    ]
    rules = [rule for rule in RULES if rule != "command" or manifest.command]
    fitness = messages.SettingEntry(
        name="fitness",
        type="text",
        default=manifest.fitness,
        choices=rules,
        description="; ".join(RULES[rule] for rule in rules),
    )
    return [*offered, fitness]


def _check_launch(manifest: LaunchManifest, package: Path) -> None:
    """Check that there is a launch file, and that it ends."""
    file = package / manifest.launch
    if not file.is_file():
        raise ConfigError(
            f"launch: package {manifest.package!r} has no file {manifest.launch}"
        )
    text = file.read_text(encoding="utf-8", errors="replace")
    if "required=" not in text and "<include" not in text:
        raise ConfigError(
            f'launch: {manifest.launch} has no node with required="true"; expected one that ends '
            "when the trial is over: then roslaunch ends the others, and itself"
        )


def _check_robots(manifest: LaunchManifest) -> None:
    if manifest.robot is not None and (manifest.inputs < 3 or manifest.outputs != 2):
        raise ConfigError(
            "robot: it has a number for each sector of its scan and 2 for the nearest target, and "
            f"takes 2; expected inputs = 3 or more and outputs = 2, not {manifest.inputs} and "
            f"{manifest.outputs}"
        )
    robots = manifest.robots
    default = getattr(manifest.settings.get(str(robots)), "default", None)
    if isinstance(robots, str) and type(default) is not int:
        raise ConfigError(
            f"robots: expected a number, or the name of a setting with one, not {robots!r}"
        )


def _check_manifest(manifest: LaunchManifest) -> None:
    for what, count in (("sensors", manifest.inputs), ("actuators", manifest.outputs)):
        names = getattr(manifest, what)
        if names and len(names) != count:
            raise ConfigError(f"{what}: expected {count} names or none, not {len(names)}")
    _check_robots(manifest)
    program = ", a program with its arguments"
    if manifest.fitness == "command" and not manifest.command:
        raise ConfigError(f"fitness: command: expected the key command{program}")
    if not PurePosixPath(manifest.logs).parts:
        raise ConfigError(
            "logs: expected a folder in the package, which is emptied before each trial"
        )
    if manifest.controller.form == "c99" and not manifest.controller.rebuild:
        raise ConfigError(f"controller: c99: expected the key rebuild{program}")
    for file, values in manifest.parameters.items():
        try:
            parameters.text(values)
        except ValueError as error:
            raise ConfigError(f"parameters: {file}: {error}") from None


def _check(where: str, value: Any, target: LaunchTarget) -> None:
    """Check that the value of a setting can be written to its target.

    A text may come from an experiment over the network: roslaunch must not evaluate it.
    """
    if isinstance(value, str) and ("$(" in value or not value.isprintable()):
        raise ConfigError(
            f"{where}: expected a text without $( and control characters, not {value[:60]!r}"
        )
    try:
        parameters.value(target.argument or target.key or "", value)
    except ValueError as error:
        raise ConfigError(f"{where}: {error}") from None


def _filled(command: Sequence[str], package: Path) -> list[str]:
    return [_fill(part, package) for part in command]


def _fill(value: Any, package: Path) -> Any:
    """Replace {package} in a text by the folder of the package."""
    return (
        value.replace("{package}", os.fspath(package))
        if isinstance(value, str)
        else value
    )
