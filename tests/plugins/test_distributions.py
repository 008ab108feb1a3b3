"""The version hash covers all that a plug-in's distribution brings, and nothing of the machine."""

import hashlib
import importlib
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.parameters import some
from zswarm.plugins import registry as plugins
from zswarm.plugins import version_hash

PACKAGE, NAME = "zswarm_dataful", "dataful"
FILES = {
    "zswarm_dataful/__init__.py": b"",
    "zswarm_dataful/sim.py": b"class Sim:\n    pass\n",
    "zswarm_dataful/_core.so": b"\x7fELF 1",
    "zswarm_dataful/maps/world.map": b"map 1",
    "share/dataful/mesh.stl": b"solid 1",
    "bin/dataful": b"#!/home/ada/bin/python\n",
}
METADATA = "Metadata-Version: 2.1\nName: zswarm-dataful\nVersion: {}\n"


def forget() -> None:
    importlib.invalidate_caches()
    for module in (version_hash, plugins):
        for cached in vars(module).values():
            if hasattr(cached, "cache_clear"):
                cached.cache_clear()


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder of packages into which a plug-in was installed."""
    for name, content in FILES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(content)
    information = tmp_path / "zswarm_dataful-1.0.dist-info"
    information.mkdir()
    (information / "METADATA").write_text(METADATA.format("1.0"))
    (information / "entry_points.txt").write_text(
        f"[zswarm.simulators]\n{NAME} = {PACKAGE}.sim:Sim\n"
        "[console_scripts]\ndataful = zswarm_dataful.sim:Sim\n"
    )
    record = [*FILES, "zswarm_dataful-1.0.dist-info/METADATA"]
    (information / "RECORD").write_text("".join(f"{name},,\n" for name in record))
    monkeypatch.syspath_prepend(str(tmp_path))
    forget()
    yield tmp_path
    monkeypatch.undo()
    forget()


def hashes() -> tuple[str, str]:
    """Return the hash of the problem, and that of compiled code, computed anew."""
    forget()
    return version_hash.version_hash(NAME, "fully-meshed"), version_hash.cache_hash()


@pytest.mark.parametrize(
    "file",
    [
        "zswarm_dataful/sim.py",
        "zswarm_dataful/_core.so",
        "zswarm_dataful/maps/world.map",
        "zswarm_dataful/new.yaml",
        "share/dataful/mesh.stl",
    ],
)
def test_every_file_of_a_plug_ins_distribution_is_covered(site: Path, file: str) -> None:
    before = hashes()
    (site / file).write_bytes(b"another")
    after = hashes()
    assert before[0] != after[0]
    assert before[1] != after[1]


@pytest.mark.parametrize(
    "file",
    [
        "zswarm_dataful/__pycache__/sim.cpython-311.pyc",
        "bin/dataful",
        "zswarm_dataful-1.0.dist-info/direct_url.json",
    ],
)
def test_what_an_installation_writes_on_its_machine_is_not_covered(
    site: Path, file: str
) -> None:
    before = hashes()
    (site / file).parent.mkdir(exist_ok=True)
    (site / file).write_bytes(b"another")
    assert hashes() == before


def test_another_version_of_a_plug_in_is_named(site: Path) -> None:
    before, there = hashes(), version_hash.versions(NAME, "fully-meshed")
    (site / "zswarm_dataful-1.0.dist-info" / "METADATA").write_text(
        METADATA.format("2.0")
    )
    assert hashes()[0] != before[0]
    here = version_hash.versions(NAME, "fully-meshed")
    assert version_hash.differing(here, there) == ["zswarm-dataful 2.0 here, 1.0 there"]


def plant_lock(folder: Path) -> None:
    """What Emacs puts next to a file that is edited: a link to nothing."""
    (folder / ".#sim.py").symlink_to("ada@host.1234:567")


def plant_pipe(folder: Path) -> None:
    os.mkfifo(folder / "commands.py")


@pytest.mark.parametrize("plant", some([plant_lock, plant_pipe], plant_lock))
def test_only_regular_files_are_read(site: Path, plant: Callable[[Path], None]) -> None:
    before = hashes()
    plant(site / PACKAGE)
    assert hashes() == before
    done = subprocess.run(
        [sys.executable, "-c", "import zswarm.kernels.compiler"],
        env=os.environ | {"PYTHONPATH": str(site), "ZSWARM_CACHE": str(site / "cache")},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr


def test_an_editors_lock_in_the_package_itself_does_no_harm(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for room in ("nets", "sims"):
        (tmp_path / room).mkdir()
    monkeypatch.setattr(version_hash, "PACKAGE", tmp_path)
    monkeypatch.setattr(version_hash, "SHARED", [])
    forget()
    before = version_hash.cache_hash()
    plant_lock(tmp_path / "sims")
    forget()
    assert version_hash.cache_hash() == before
    monkeypatch.undo()
    forget()


def test_a_file_that_is_gone_before_it_is_read_counts_for_nothing(tmp_path: Path) -> None:
    assert version_hash.digest([tmp_path / "gone.py"]) == version_hash.digest([])


def test_a_large_file_is_read_once_until_it_is_changed(
    site: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A server asks for the hash of each simulator with each representation."""
    read: list[str] = []
    digested = hashlib.file_digest

    def counting(file: Any, algorithm: Any) -> Any:
        read.append(Path(file.name).name)
        return digested(file, algorithm)

    monkeypatch.setattr(hashlib, "file_digest", counting)
    for representation in plugins.names("representation"):
        version_hash.version_hash(NAME, representation)
        version_hash.versions(NAME, representation)
    version_hash.cache_hash()
    assert read.count("world.map") == 1
    (site / "zswarm_dataful/maps/world.map").write_bytes(b"a larger map")
    version_hash.version_hash.cache_clear()
    version_hash._contents.cache_clear()
    version_hash.version_hash(NAME, "neat")
    assert read.count("world.map") == 2


def test_another_minor_version_of_python_has_another_hash(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found = []
    for python in ("3.11.7", "3.11.9", "3.12.1"):
        monkeypatch.setattr(
            version_hash.platform,
            "python_version_tuple",
            lambda python=python: tuple(python.split(".")),
        )
        forget()
        problem = "xor", "fully-meshed"
        found.append(
            (version_hash.version_hash(*problem), version_hash.versions(*problem))
        )
    forget()
    (old, there), (patched, _), (new, here) = found
    assert old == patched != new
    assert version_hash.differing(here, there) == ["Python 3.12 here, 3.11 there"]


def test_another_build_of_pymunk_concerns_the_problems_that_use_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same version from conda, from Debian or of one's own compiler has other bits."""
    names, found = ("foraging-physical", "emergency-exit"), []
    assert version_hash.compiled_files("pymunk")
    for build in (b"PyPI", b"conda"):
        (tmp_path / "_chipmunk.so").write_bytes(build)
        monkeypatch.setattr(
            version_hash, "compiled_files", lambda _: [tmp_path / "_chipmunk.so"]
        )
        forget()
        found.append({name: version_hash.version_hash(name, "neat") for name in names})
        found.append(version_hash.versions("foraging-physical", "neat"))
    forget()
    one, there, other, here = found
    assert [one[name] == other[name] for name in names] == [False, True]
    assert version_hash.differing(here, there) == ["other build of pymunk"]


BESIDE = {
    "zswarm_one.py": "import numpy, world\nclass Sim:\n    pass\n",
    "world.py": "def load():\n    from deep import walls\n",
    "deep/__init__.py": "import far\n",
    "deep/walls.map": "map 1",
    "far.py": "x = 1\n",
}


def install_one(site: Path, code: Path, files: list[str]) -> None:
    """Write the code of a plug-in to a folder, and its metadata to a site."""
    for name, text in (BESIDE | {"unrelated.py": "x = 1\n"}).items():
        (code / name).parent.mkdir(exist_ok=True)
        (code / name).write_text(text)
    information = site / "zswarm_one-1.0.dist-info"
    information.mkdir()
    (information / "METADATA").write_text(
        METADATA.format("1.0").replace("dataful", "one")
    )
    (information / "entry_points.txt").write_text(
        "[zswarm.simulators]\none = zswarm_one:Sim\n"
    )
    (information / "RECORD").write_text("".join(f"{name},,\n" for name in files))


def hash_of_one() -> str:
    forget()
    return version_hash.version_hash("one", "fully-meshed")


@pytest.mark.parametrize("file", [*BESIDE, "unrelated.py"])
def test_modules_beside_an_editable_plug_in_that_it_imports_are_covered(
    site: Path, tmp_path_factory: pytest.TempPathFactory, file: str
) -> None:
    """An editable installation names a folder, and lists no files."""
    work = tmp_path_factory.mktemp("work")
    install_one(site, work, ["zswarm_one.pth"])
    with pytest.MonkeyPatch.context() as patched:
        patched.syspath_prepend(str(work))
        before = hash_of_one()
        (work / file).write_text("another = 1\n")
        after = hash_of_one()
    assert (before != after) is (file in BESIDE)


def test_an_editable_plug_in_has_the_hash_of_its_wheel(
    site: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    found = []
    for where in ("work", "wheel"):
        packages = tmp_path_factory.mktemp("packages")
        code = tmp_path_factory.mktemp(where) if where == "work" else packages
        files = ["zswarm_one.pth"] if where == "work" else list(BESIDE)
        install_one(packages, code, files)
        with pytest.MonkeyPatch.context() as patched:
            for folder in {packages, code}:
                patched.syspath_prepend(str(folder))
            found.append(hash_of_one())
    assert found[0] == found[1]
