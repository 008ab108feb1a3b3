"""Simulators, representations, optimizers and rankings by name: the bundled ones and plug-ins.

A package adds parts through the entry-point groups ``zswarm.simulators``,
``zswarm.representations``, ``zswarm.optimizers`` and ``zswarm.rankings``; a manifest makes a
program a simulator (``manifests.py``). Listing parts imports and starts none of them, so a broken
plug-in does not affect others.
"""

import importlib
import re
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from zswarm.config.suggest import nearest
from zswarm.errors import UnknownPlugin
from zswarm.plugins import distributions, manifests

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

Kind = Literal["simulator", "representation", "optimizer", "ranking"]

BUNDLED: dict[Kind, dict[str, str]] = {
    "simulator": {
        "arena": "zswarm.sims.arena:Arena",
        "box-pushing": "zswarm.sims.box_pushing:BoxPushing",
        "emergency-exit": "zswarm.sims.emergency_exit:EmergencyExit",
        "epuck": "zswarm.sims.epuck.simulator:Epuck",
        "food-or-poison": "zswarm.sims.food_or_poison:FoodOrPoison",
        "foraging-physical": "zswarm.sims.foraging_physical:ForagingPhysical",
        "gymnasium": "zswarm.sims.adapters.gymnasium:Gymnasium",
        "inverted-pendulum": "zswarm.sims.inverted_pendulum:InvertedPendulum",
        "light": "zswarm.sims.light:Light",
        "maze": "zswarm.sims.maze:Maze",
        "minisim": "zswarm.sims.minisim:Minisim",
        "pettingzoo": "zswarm.sims.adapters.pettingzoo:PettingZoo",
        "simplified-emergency-exit": "zswarm.sims.simplified_emergency_exit:SimplifiedEmergencyExit",  # noqa: E501
        "turtlebot-exit": "zswarm.sims.turtlebot_exit:TurtlebotExit",
        "turtlebot-exit-ros": "zswarm.ros.simulation.simulator:TurtlebotExitRos",
        "vmas": "zswarm.sims.adapters.vmas:Vmas",
        "xor": "zswarm.sims.xor:XOR",
    },
    "representation": {
        "bulk": "zswarm.nets.bulk:Bulk",
        "chocolate": "zswarm.nets.chocolate:Chocolate",
        "ctrnn": "zswarm.nets.ctrnn:CTRNN",
        "feed-forward": "zswarm.nets.feed_forward:FeedForward",
        "fully-meshed": "zswarm.nets.fully_meshed:FullyMeshed",
        "hebbian": "zswarm.nets.hebbian:Hebbian",
        "mealy": "zswarm.nets.mealy:Mealy",
        "neat": "zswarm.nets.neat:Neat",
        "three-layer": "zswarm.nets.feed_forward:ThreeLayer",
    },
    "optimizer": {
        "cea2d": "zswarm.ot.optimizers.cea2d:CEA2D",
        "cma-me": "zswarm.ot.optimizers.elites:CmaMe",
        "cmaes": "zswarm.ot.optimizers.cmaes:CMAES",
        "cuckoo": "zswarm.ot.optimizers.cuckoo:CuckooSearch",
        "map-elites": "zswarm.ot.optimizers.elites:MapElites",
        "neat": "zswarm.ot.optimizers.neat:NEAT",
        "nnga": "zswarm.ot.optimizers.nnga:NNGA",
        "novelty": "zswarm.ot.optimizers.novelty:Novelty",
        "openai-es": "zswarm.ot.optimizers.openai_es:OpenAIES",
        "pso": "zswarm.ot.optimizers.pso:PSO",
        "random": "zswarm.ot.optimizers.random_search:RandomSearch",
    },
    "ranking": {
        "absolute": "zswarm.ot.rankings.absolute:Absolute",
        "full-tournament": "zswarm.ot.rankings.full_tournament:FullTournament",
        "multi-swiss": "zswarm.ot.rankings.multi_swiss:MultiSwiss",
        "swiss": "zswarm.ot.rankings.swiss:Swiss",
    },
}
PACKAGE = Path(__file__).parents[1]
# Import statements, found by a regular expression because parsing a file is slow.
IMPORT = re.compile(
    r"^\s*(?:from|import)\s+zswarm\.((?:nets|sims|ros|robots)[\w.]*)"
    r"(?:\s+import\s+(\([^)]*\)|.*))?",
    re.M,
)
DECLARED = re.compile(r"^LIBRARIES = \(([^)]*)\)", re.M)
FOREIGN = "zswarm.sims.foreign.simulator"  # makes classes of programs
ROS_FILES = "zswarm.ros.launch.files"  # makes classes of launch files
COMPOSED = {("representation", "bulk")}  # made of the other bundled parts of their kind


@cache
def _installed(kind: Kind) -> dict[str, "EntryPoint"]:
    # Help and completion do without, which takes 20 ms to import.
    from importlib.metadata import EntryPoint

    group = f"zswarm.{kind}s"
    table = {point.name: point for point in entry_points().select(group=group)}
    return table | {
        name: EntryPoint(name, target, group) for name, target in BUNDLED[kind].items()
    }


@cache  # reading them takes longer than all else that a command does with them
def entry_points() -> Any:
    """Return the entry points of all installed distributions."""
    from importlib.metadata import entry_points

    return entry_points()


def foreign(kind: Kind) -> dict[str, Path]:
    """Return the manifests of a kind's programs by name; bundled parts and plug-ins win."""
    found = manifests.find() if kind == "simulator" else {}
    return {name: path for name, path in found.items() if name not in _installed(kind)}


def names(kind: Kind) -> list[str]:
    """Return all names of a kind, sorted."""
    return sorted({*_installed(kind), *foreign(kind)})


def _manifest(kind: Kind, name: str) -> Path | None:
    """Return the manifest of a name that no bundled part or plug-in has."""
    return None if name in _installed(kind) else foreign(kind).get(name)


def load(kind: Kind, name: str) -> Any:
    """Return the class of a name, or raise ``UnknownPlugin``."""
    if manifest := _manifest(kind, name):
        return importlib.import_module(_maker(manifest)).simulator_class(name, manifest)
    point = _entry_point(kind, name)
    try:
        return point.load()
    except (Exception, SystemExit) as error:  # a plug-in's code may raise anything
        if name in BUNDLED[kind]:
            raise
        raise UnknownPlugin(
            f"{kind} {name!r} cannot be imported: {type(error).__name__}: {error}"
        ) from error


def _entry_point(kind: Kind, name: str) -> "EntryPoint":
    table = _installed(kind)
    if name not in table:
        known = names(kind)
        meant = nearest(name, known)
        raise UnknownPlugin(
            f"unknown {kind} {name!r}{meant}; known are: {', '.join(known)}"
        )
    return table[name]


def source_files(kind: Kind, name: str) -> list[Path]:
    """Return the files that determine what a part computes, without importing it.

    - Bundled part: its module and those next to it whose names begin with its name
      (``arena_world.py``); for a composed part those of all parts that it may be made of.
    - Plug-in: every file of its top-level package and of its distribution.
    - Program or launch file: its manifest, the files named there, and the modules that talk to it.

    Bundled modules of simulators, representations and robots that these import are added.
    """
    if manifest := _manifest(kind, name):
        own = sorted(_bundled_files(_maker(manifest)))
        return [*manifests.files(manifest), *own, *_imports(own)]
    point = _entry_point(kind, name)
    if name not in BUNDLED[kind]:
        own = distributions.plugin_files(_package(point), point.dist)
    else:
        targets = BUNDLED[kind].values() if (kind, name) in COMPOSED else [point.value]
        modules = [target.partition(":")[0] for target in targets]
        own = sorted({file for module in modules for file in _bundled_files(module)})
    return [*own, *_imports(own)]


def libraries(files: Iterable[Path]) -> list[str]:
    """Return the packages in ``LIBRARIES = (...)`` of Python files, sorted: they compute, too."""
    texts = [_text(file) for file in files if file.suffix == ".py"]
    lists = [found for text in texts for found in DECLARED.findall(text)]
    return sorted(
        {name for found in lists for name in re.findall(r"[\"']([^\"']+)[\"']", found)}
    )


def plugin_files() -> list[Path]:
    """Return the files of all installed plug-in simulators and representations.

    Not only those of Python: kernels are compiled with the arrays that modules load.
    """
    points = [
        point
        for kind in ("simulator", "representation")
        for name, point in _installed(kind).items()
        if name not in BUNDLED[kind]
    ]
    packages = {_package(point): point.dist for point in points}
    return [
        file
        for package, source in sorted(packages.items(), key=itemgetter(0))
        for file in distributions.plugin_files(package, source)
    ]


def distribution_versions(kind: Kind, name: str) -> dict[str, str]:
    """Return name and version of the distribution that a plug-in came with; bundled parts: {}."""
    if name in BUNDLED[kind] or _manifest(kind, name):
        return {}
    source = _entry_point(kind, name).dist
    return {source.name: source.version} if source is not None else {}


def _package(point: "EntryPoint") -> str:
    return point.module.split(".")[0]


def _maker(manifest: Path) -> str:
    return ROS_FILES if manifests.launches(manifest) else FOREIGN


def _imports(own: Sequence[Path]) -> list[Path]:
    """Return the bundled modules that modules import, directly or not, without themselves."""
    waiting, found = [file for file in own if file.suffix == ".py"], set[Path]()
    while waiting:
        more = _imported(waiting.pop()) - found
        found |= more
        waiting += more
    return sorted(found - set(own))


def _bundled_files(module: str) -> Iterator[Path]:
    *folders, own = module.split(".")[1:]
    yield from PACKAGE.joinpath(*folders).glob(f"{own}*.py")


@cache  # many import the same
def _imported(file: Path) -> frozenset[Path]:
    found = set[Path]()
    for module, names in IMPORT.findall(_text(file)):
        path = PACKAGE.joinpath(*module.split("."))
        found.update((path.with_suffix(".py"), path / "__init__.py"))
        found.update(path / f"{name}.py" for name in re.findall(r"\w+", names))
    return frozenset(path for path in found if path.is_file())


def _text(file: Path) -> str:
    return file.read_text(encoding="utf-8", errors="replace")
