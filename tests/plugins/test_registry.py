"""Parts by name: bundled ones, plug-ins, and plug-ins that are broken."""

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from zswarm.config.suggest import nearest
from zswarm.errors import ConfigError, UnknownPlugin
from zswarm.nets.representation import Representation
from zswarm.ot.optimizers.optimizer import Optimizer
from zswarm.ot.rankings.ranking import Ranking
from zswarm.plugins import registry as plugins
from zswarm.plugins import version_hash as version_hashes
from zswarm.plugins.version_hash import cache_hash, version_hash
from zswarm.sims.simulator import Simulator

Install = Callable[..., Path]
KINDS: dict[plugins.Kind, type] = {
    "simulator": Simulator,
    "representation": Representation,
    "optimizer": Optimizer,
    "ranking": Ranking,
}
NOTHING_READ = "raise AssertionError('imported')"


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Install]:
    """Install a package for this test: its files, and what it adds to the entry points."""
    monkeypatch.syspath_prepend(str(tmp_path))
    loaded = set(sys.modules)

    def forget() -> None:
        for cached in (*vars(plugins).values(), *vars(version_hashes).values()):
            if hasattr(cached, "cache_clear"):
                cached.cache_clear()

    def write(files: dict[str, str], points: str) -> Path:
        for name, text in files.items():
            path = tmp_path / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
        information = tmp_path / "swarm_extra-1.0.dist-info"
        information.mkdir()
        (information / "METADATA").write_text(
            "Metadata-Version: 2.1\nName: swarm-extra\nVersion: 1.0\n"
        )
        (information / "entry_points.txt").write_text(points)
        forget()
        return tmp_path

    yield write
    for name in set(sys.modules) - loaded:
        if name.startswith("swarm_extra"):
            del sys.modules[name]
    forget()


@pytest.mark.parametrize("kind", KINDS)
def test_every_bundled_part_is_of_its_kind(kind: plugins.Kind) -> None:
    assert set(plugins.BUNDLED[kind]) <= set(plugins.names(kind))
    for name in plugins.BUNDLED[kind]:
        part = plugins.load(kind, name)
        assert issubclass(part, KINDS[kind])
        assert part.settings_type
        assert part.__doc__, "a data sheet"


def test_names_are_sorted() -> None:
    assert plugins.names("simulator") == sorted(plugins.names("simulator"))


def test_a_package_adds_a_part_by_an_entry_point(install: Install) -> None:
    install(
        {"swarm_extra.py": "class Labyrinth: ..."},
        "[zswarm.simulators]\nlabyrinth = swarm_extra:Labyrinth\n",
    )
    assert "labyrinth" in plugins.names("simulator")
    assert "labyrinth" not in plugins.names("optimizer")
    assert plugins.load("simulator", "labyrinth").__name__ == "Labyrinth"


def test_listing_and_hashing_import_nothing(install: Install) -> None:
    install(
        {"swarm_extra.py": NOTHING_READ},
        "[zswarm.simulators]\nlabyrinth = swarm_extra:Labyrinth\n",
    )
    assert "labyrinth" in plugins.names("simulator")
    assert plugins.source_files("simulator", "labyrinth")
    assert plugins.plugin_files()
    assert "swarm_extra" not in sys.modules


@pytest.mark.parametrize(
    ("code", "reason"),
    [
        ("raise RuntimeError('no licence')", "RuntimeError: no licence"),
        (
            "import module_that_is_not_there",
            "ModuleNotFoundError: No module named 'module_that_is_not_there'",
        ),
        ("1 / 0", "ZeroDivisionError: division by zero"),
        ("def f(:", "SyntaxError: "),
        ("", "AttributeError: module 'swarm_extra' has no attribute 'Labyrinth'"),
    ],
)
def test_a_plugin_that_cannot_be_imported_is_named_in_one_line(
    install: Install, code: str, reason: str
) -> None:
    install(
        {"swarm_extra.py": code},
        "[zswarm.simulators]\nlabyrinth = swarm_extra:Labyrinth\n",
    )
    with pytest.raises(UnknownPlugin) as refusal:
        plugins.load("simulator", "labyrinth")
    assert str(refusal.value).startswith(
        f"simulator 'labyrinth' cannot be imported: {reason}"
    )
    assert "\n" not in str(refusal.value)


def test_a_broken_plugin_does_not_affect_others(install: Install) -> None:
    install(
        {"swarm_extra.py": "raise RuntimeError"},
        "[zswarm.simulators]\nlabyrinth = swarm_extra:Labyrinth\n",
    )
    assert plugins.load("simulator", "minisim")
    assert version_hash("minisim", "fully-meshed")


def test_a_plugin_cannot_take_a_bundled_name(install: Install) -> None:
    install(
        {"swarm_extra.py": NOTHING_READ},
        "[zswarm.simulators]\nminisim = swarm_extra:Other\n",
    )
    assert plugins.load("simulator", "minisim").__module__ == "zswarm.sims.minisim"
    assert plugins.source_files("simulator", "minisim")[0].name == "minisim.py"


def test_a_missing_module_is_named(install: Install) -> None:
    install({}, "[zswarm.simulators]\nlabyrinth = swarm_extra:Labyrinth\n")
    with pytest.raises(
        UnknownPlugin,
        match="simulator 'labyrinth' cannot be imported: ModuleNotFoundError",
    ):
        plugins.load("simulator", "labyrinth")
    assert plugins.source_files("simulator", "labyrinth") == []


def test_all_files_of_a_plugins_package_are_in_its_hash(install: Install) -> None:
    files = {
        "swarm_extra/__init__.py": "",
        "swarm_extra/labyrinth.py": NOTHING_READ,
        "swarm_extra/deep/walls.py": "A = 1",
    }
    folder = install(
        files, "[zswarm.simulators]\nlabyrinth = swarm_extra.labyrinth:Labyrinth\n"
    )
    assert {
        str(path.relative_to(folder))
        for path in plugins.source_files("simulator", "labyrinth")
    } == set(files)
    before = version_hash("labyrinth", "fully-meshed"), cache_hash()
    (folder / "swarm_extra/deep/walls.py").write_text("A = 2")
    for remembered in (version_hash, cache_hash, version_hashes._contents):
        remembered.cache_clear()
    assert version_hash("labyrinth", "fully-meshed") != before[0]
    assert cache_hash() != before[1]


ENVIRONMENT = """
import numpy as np
from zswarm.sims.adapters.environments import ParallelEnvironment
LIBRARIES = (
    "some-physics",
    "gymnasium",
)
"""


def test_the_hash_of_a_plugin_covers_bundled_parts_and_libraries_it_uses(
    install: Install,
) -> None:
    """Bundled files come after its own files, wherever both are installed."""
    files = {
        "swarm_extra/__init__.py": "from zswarm.nets import (bulk,\n ctrnn)",
        "swarm_extra/walls.py": ENVIRONMENT,
    }
    install(files, "[zswarm.simulators]\nlabyrinth = swarm_extra:Labyrinth\n")
    found = plugins.source_files("simulator", "labyrinth")
    assert [path.name for path in found[:2]] == ["__init__.py", "walls.py"]
    assert {"bulk.py", "ctrnn.py", "environments.py", "neurons.py"} <= {
        path.name for path in found[2:]
    }
    assert {path.parent.name for path in found[2:]} == {"nets", "sims", "adapters"}
    assert plugins.libraries(found) == ["gymnasium", "some-physics"]


def test_a_package_is_hashed_with_the_modules_that_it_hands_on(
    install: Install,
) -> None:
    install(
        {"swarm_extra.py": "from zswarm.sims.toolbox import ray"},
        "[zswarm.simulators]\nlabyrinth = swarm_extra:Labyrinth\n",
    )
    found = {path.name for path in plugins.source_files("simulator", "labyrinth")}
    assert {"bodies.py", "sensor_noise.py", "sensors.py"} < found


def test_an_optimizer_plugin_does_not_change_the_cache_hash(install: Install) -> None:
    before = cache_hash()
    install(
        {"swarm_extra.py": NOTHING_READ}, "[zswarm.optimizers]\nmine = swarm_extra:Mine\n"
    )
    assert "mine" in plugins.names("optimizer")
    assert cache_hash() == before


def test_an_unknown_name_is_refused_with_the_nearest_and_all_known() -> None:
    with pytest.raises(ConfigError) as refusal:
        plugins.load("simulator", "mini-sim")
    assert str(refusal.value).startswith(
        "unknown simulator 'mini-sim' (did you mean 'minisim'?); known are: "
    )
    for name in plugins.names("simulator"):
        assert name in str(refusal.value)


@pytest.mark.parametrize(
    ("word", "answer"), [("optimiser", " (did you mean 'optimizer'?)"), ("xyz", "")]
)
def test_a_word_is_suggested_only_if_it_is_close(word: str, answer: str) -> None:
    assert nearest(word, ["optimizer", "problem"]) == answer
