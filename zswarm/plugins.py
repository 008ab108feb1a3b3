"""Simulators, representations, optimizers and rankings by name: the bundled tables, and what others add.

A package adds its own through the entry-point groups ``zswarm.simulators``, ``zswarm.representations``, ``zswarm.optimizers``
and ``zswarm.rankings``; a program becomes a simulator by a manifest (``manifests.py``). A part is imported, or its
program started, when it is asked for, never by listing it, so a broken plug-in hurts nobody who does not use it.
"""

import importlib
import importlib.util
import re
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, Literal

from zswarm import manifests
from zswarm.errors import UnknownPlugin
from zswarm.nearest import nearest

Kind = Literal["simulator", "representation", "optimizer", "ranking"]

BUNDLED: dict[Kind, dict[str, str]] = {
    "simulator": {
        "arena": "zswarm.sims.arena:Arena",
        "box-pushing": "zswarm.sims.box_pushing:BoxPushing",
        "emergency-exit": "zswarm.sims.emergency_exit:EmergencyExit",
        "food-or-poison": "zswarm.sims.food_or_poison:FoodOrPoison",
        "foraging-physical": "zswarm.sims.foraging_physical:ForagingPhysical",
        "gymnasium": "zswarm.sims.gymnasium:Gymnasium",
        "inverted-pendulum": "zswarm.sims.inverted_pendulum:InvertedPendulum",
        "light": "zswarm.sims.light:Light",
        "maze": "zswarm.sims.maze:Maze",
        "minisim": "zswarm.sims.minisim:Minisim",
        "pettingzoo": "zswarm.sims.pettingzoo:PettingZoo",
        "simplified-emergency-exit": "zswarm.sims.simplified_emergency_exit:SimplifiedEmergencyExit",
        "turtlebot-exit": "zswarm.sims.turtlebot_exit:TurtlebotExit",
        "turtlebot-exit-ros": "zswarm.ros.simulator:TurtlebotExitRos",
        "vmas": "zswarm.sims.vmas:Vmas",
        "xor": "zswarm.sims.xor:XOR",
    },
    "representation": {
        "bulk": "zswarm.nets.bulk:Bulk",
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
OF_ONE = re.compile(
    r"^\s*(?:from|import)\s+zswarm\.(nets|sims|ros|robots)\.(\w+)", re.M
)  # imports; looked for, for parsing takes long
OF_SEVERAL = re.compile(r"^\s*from\s+zswarm\.(nets|sims|ros|robots)\s+import\s+(\([^)]*\)|.*)", re.M)
DECLARED = re.compile(r"^LIBRARIES = \(([^)]*)\)", re.M)
FOREIGN = "zswarm.sims.foreign"  # makes classes of programs
ROS_FILES = "zswarm.ros.files"  # and of launch files
COMPOSED = {("representation", "bulk")}  # made of other bundled parts of their kind, which settings name


@cache
def _installed(kind: Kind) -> dict[str, EntryPoint]:
    group = f"zswarm.{kind}s"
    table = {point.name: point for point in entry_points(group=group)}
    return table | {name: EntryPoint(name, target, group) for name, target in BUNDLED[kind].items()}


def foreign(kind: Kind) -> dict[str, Path]:
    """The manifests of a kind's parts that are programs, by name; what is bundled or a package's goes before."""
    found = manifests.find() if kind == "simulator" else {}
    return {name: path for name, path in found.items() if name not in _installed(kind)}


def names(kind: Kind) -> list[str]:
    """All names of a kind, sorted."""
    return sorted({*_installed(kind), *foreign(kind)})


def load(kind: Kind, name: str) -> Any:
    """The class behind a name.

    Raises:
        UnknownPlugin: no such name, or the package or program behind it cannot be used; the text says which.
    """
    table = _installed(kind)
    programs = foreign(kind)
    if name in programs:
        return importlib.import_module(_maker(programs[name])).simulator_class(name, programs[name])
    if name not in table:
        raise _unknown(kind, name)
    try:
        return table[name].load()
    except (Exception, SystemExit) as error:  # a plug-in's import runs code of its authors: whatever it raises is named, not ours
        if name in BUNDLED[kind]:
            raise
        raise UnknownPlugin(f"{kind} {name!r} cannot be imported: {type(error).__name__}: {error}") from error


def _unknown(kind: Kind, name: str) -> UnknownPlugin:
    known = names(kind)
    return UnknownPlugin(f"unknown {kind} {name!r}{nearest(name, known)}; known are: {', '.join(known)}")


def source_files(kind: Kind, name: str) -> list[Path]:
    """The files whose change can change what a part computes, without importing it.

    For a bundled part its own module and those beside it whose names begin with its name (``arena_world.py``), and for a composed
    one those of all that it may be made of; for a plug-in every file of its top-level package; and the bundled modules of
    simulators and representations that these import. For a program or a launch file its manifest, the files that this names, and
    the modules that speak with programs, or launch.

    Raises:
        UnknownPlugin: no such name.
    """
    if manifest := foreign(kind).get(name):
        maker = _maker(manifest)
        own = sorted(_bundled_files(maker))
        return [*manifests.files(manifest), *own, *(_following(own) if maker == ROS_FILES else [])]
    if name not in _installed(kind):
        raise _unknown(kind, name)
    if name not in BUNDLED[kind]:
        own = list(_package_files(_installed(kind)[name].module.split(".")[0]))
    else:
        names = BUNDLED[kind] if (kind, name) in COMPOSED else [name]
        own = sorted({file for part in names for file in _bundled_files(BUNDLED[kind][part].partition(":")[0])})
    return [*own, *_following(own)]


def libraries(files: Iterable[Path]) -> list[str]:
    """What ``LIBRARIES = ("...", ...)`` in Python files names, sorted: packages that compute, beside those of all parts."""
    lists = [found for file in files if file.suffix == ".py" for found in DECLARED.findall(_text(file))]
    return sorted({name for found in lists for name in re.findall(r"[\"']([^\"']+)[\"']", found)})


def plugin_files() -> list[Path]:
    """The Python files of all installed simulator and representation plug-ins that are not bundled."""
    packages = {
        point.module.split(".")[0]
        for kind in ("simulator", "representation")
        for name, point in _installed(kind).items()
        if name not in BUNDLED[kind]
    }
    return [file for package in sorted(packages) for file in _package_files(package)]


def _maker(manifest: Path) -> str:
    return ROS_FILES if manifests.launches(manifest) else FOREIGN


def _following(own: Sequence[Path]) -> list[Path]:
    """The bundled modules of simulators and representations that modules import, or these, but for themselves."""
    waiting, imported = list(own), set[Path]()
    while waiting:
        more = _imported(waiting.pop()) - imported
        imported |= more
        waiting += more
    return sorted(imported - set(own))


def _bundled_files(module: str) -> Iterator[Path]:
    *folders, own = module.split(".")[1:]
    yield from Path(__file__).parent.joinpath(*folders).glob(f"{own}*.py")


def _imported(file: Path) -> set[Path]:
    """The bundled modules of simulators and representations that a file imports."""
    text = _text(file)
    named = set(OF_ONE.findall(text))
    named |= {(folder, name) for folder, names in OF_SEVERAL.findall(text) for name in re.findall(r"\w+", names)}
    found = {Path(__file__).parent / folder / f"{name}.py" for folder, name in named}
    return {module for module in found if module.is_file()}


def _text(file: Path) -> str:
    return file.read_text(encoding="utf-8", errors="replace")


def _package_files(package: str) -> Iterator[Path]:
    spec = importlib.util.find_spec(package)
    if spec is None:
        return
    if spec.submodule_search_locations:
        for folder in spec.submodule_search_locations:
            yield from sorted(Path(folder).rglob("*.py"))
    elif spec.origin:
        yield Path(spec.origin)
