"""The version hash changes with all code that decides a result, and with nothing else."""

import ast
import re
import shutil
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from tests.repository import REPOSITORY
from zswarm.plugins import registry as plugins
from zswarm.plugins import version_hash

PACKAGE = version_hash.PACKAGE
# Rooms that name, check and refuse. config/ranges.py computes, and is one of the shared files.
COMPUTES_NOTHING = (
    "errors.py",
    "config/",
    "kernels/cache.py",
    "nets/graph.py",
    "plugins/",
    "protocol/",
    "system/",
)


def imported(file: Path) -> set[Path]:
    """The modules of the package that a module imports, whatever those import included."""
    found: set[Path] = set()
    waiting = [file]
    while waiting:
        more = named(waiting.pop()) - found
        found |= more
        waiting += more
    return found


@cache
def named(file: Path) -> set[Path]:
    """Return the files of the package that a file's own text imports."""
    found = set()
    for node in ast.walk(ast.parse(file.read_text())):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [
                node.module or "",
                *(f"{node.module}.{alias.name}" for alias in node.names),
            ]
        for name in names:
            module = PACKAGE.parent.joinpath(*name.split(".")).with_suffix(".py")
            if name.startswith("zswarm.") and module.is_file():
                found.add(module)
    return found


@pytest.fixture(autouse=True)
def clean() -> Iterator[None]:
    yield
    forget()


@pytest.fixture
def copy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the package that is hashed in its place."""
    shutil.copytree(
        PACKAGE,
        tmp_path / "zswarm",
        ignore=shutil.ignore_patterns("__pycache__", "examples"),
    )
    for module in (version_hash, plugins):
        monkeypatch.setattr(module, "PACKAGE", tmp_path / "zswarm")
    return tmp_path / "zswarm"


def fresh() -> tuple[str, str]:
    """Return the hash of a problem, and that of all compiled code, not remembered."""
    forget()
    return version_hash.version_hash(
        "emergency-exit", "fully-meshed"
    ), version_hash.cache_hash()


def forget() -> None:
    for remembered in (*vars(version_hash).values(), *vars(plugins).values()):
        if hasattr(remembered, "cache_clear"):
            remembered.cache_clear()


def test_a_hash_is_32_hex_digits_and_stays() -> None:
    first = fresh()
    assert first == fresh()
    assert all(re.fullmatch("[0-9a-f]{32}", text) for text in first)


def test_another_simulator_has_another_hash() -> None:
    hashes = {
        version_hash.version_hash(simulator, "fully-meshed")
        for simulator in plugins.BUNDLED["simulator"]
    }
    assert len(hashes) == len(plugins.BUNDLED["simulator"])


@pytest.mark.parametrize(
    "file", [*version_hash.SHARED, "sims/emergency_exit.py", "nets/fully_meshed.py"]
)
def test_a_change_in_a_file_that_computes_changes_both_hashes(
    copy: Path, file: str
) -> None:
    before = fresh()
    (copy / file).write_text((copy / file).read_text() + "\n")
    after = fresh()
    assert before[0] != after[0]
    assert before[1] != after[1]


def test_a_network_of_networks_has_a_new_version_when_a_part_changes(
    copy: Path,
) -> None:
    """Settings say which they are; the hash is asked for without."""
    before = [
        version_hash.version_hash("minisim", kind) for kind in ("bulk", "three-layer")
    ]
    (copy / "nets/ctrnn.py").write_text("# changed\n")
    forget()
    after = [
        version_hash.version_hash("minisim", kind) for kind in ("bulk", "three-layer")
    ]
    assert before[0] != after[0]
    assert before[1] == after[1]


@pytest.mark.parametrize(
    "file", ["ot/optimizers/nnga.py", "protocol/keys.py", "errors.py"]
)
def test_an_unrelated_change_changes_neither_hash(copy: Path, file: str) -> None:
    before = fresh()
    (copy / file).write_text((copy / file).read_text() + "\n")
    assert fresh() == before


def test_a_change_in_another_simulator_changes_only_the_cache_hash(copy: Path) -> None:
    before = fresh()
    (copy / "sims/minisim.py").write_text("# changed\n")
    after = fresh()
    assert before[0] == after[0]
    assert before[1] != after[1]


def test_a_new_simulator_changes_only_the_cache_hash(copy: Path) -> None:
    before = fresh()
    (copy / "sims/new.py").write_text("# new\n")
    after = fresh()
    assert before[0] == after[0]
    assert before[1] != after[1]


def test_two_files_that_swap_their_contents_change_the_hash(tmp_path: Path) -> None:
    one, other = tmp_path / "one.py", tmp_path / "other.py"
    one.write_text("1")
    other.write_text("2")
    before = version_hash.digest([one, other])
    assert version_hash.digest([one, other]) == before
    one.write_text("2")
    other.write_text("1")
    assert version_hash.digest([one, other]) != before


@pytest.mark.parametrize("library", ["numba", "llvmlite", "numpy", "pymunk"])
def test_another_version_of_a_library_changes_both_hashes(
    library: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = fresh()
    installed = version_hash.version
    monkeypatch.setattr(
        version_hash,
        "version",
        lambda name: "0.0.1" if name == library else installed(name),
    )
    after = fresh()
    assert before[0] != after[0]
    assert before[1] != after[1]


def test_the_protocols_document_lists_the_shared_files_in_order() -> None:
    page = (REPOSITORY / "docs" / "protocol.md").read_text(encoding="utf-8")
    listed = re.search(r"of the package `zswarm`, in this order: (.*?);", page, re.DOTALL)
    assert listed is not None
    assert re.findall(r"`(.*?)`", listed[1]) == version_hash.SHARED


@pytest.mark.parametrize("kind", ["simulator", "representation"])
def test_every_module_that_computes_for_a_part_is_hashed(kind: plugins.Kind) -> None:
    shared = {PACKAGE / name for name in version_hash.SHARED}
    for name in plugins.BUNDLED[kind]:
        own = set(plugins.source_files(kind, name))
        needed = own.union(*map(imported, own), imported(PACKAGE / "evaluate.py"))
        paths = {str(file.relative_to(PACKAGE)) for file in needed - shared - own}
        assert [path for path in paths if not path.startswith(COMPUTES_NOTHING)] == []


@pytest.mark.parametrize("other", ["another version", "another architecture"])
def test_the_version_hash_covers_libraries_that_play_trials(
    other: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It says so by LIBRARIES, and only the simulators that do are concerned."""
    fresh()
    before = {
        name: version_hash.version_hash(name, "fully-meshed")
        for name in ("pettingzoo", "gymnasium", "vmas", "xor")
    }
    if other == "another architecture":
        monkeypatch.setattr(version_hash.platform, "machine", lambda: "riscv64")
    else:
        installed = version_hash.version
        monkeypatch.setattr(
            version_hash,
            "version",
            lambda name: "0.0.1" if name == "gymnasium" else installed(name),
        )
    forget()
    after = {name: version_hash.version_hash(name, "fully-meshed") for name in before}
    assert {name for name in before if before[name] != after[name]} == {
        "pettingzoo",
        "gymnasium",
        "vmas",
    }


def test_a_missing_library_has_no_version() -> None:
    assert version_hash._further(("zswarm-none",))["zswarm-none"] == "none"


def test_packages_that_add_to_an_entry_point_group_are_covered(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Gymnasium's environments may be of any package."""
    before = fresh(), version_hash.version_hash("gymnasium", "fully-meshed")
    information = tmp_path / "some_environments-3.0.dist-info"
    information.mkdir()
    (information / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: some-environments\nVersion: 3.0\n"
    )
    (information / "entry_points.txt").write_text(
        "[gymnasium.envs]\nsome = some_environments:register\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    after = fresh(), version_hash.version_hash("gymnasium", "fully-meshed")
    assert (
        version_hash.versions("gymnasium", "fully-meshed")["some-environments"] == "3.0"
    )
    assert before[0] == after[0]
    assert before[1] != after[1]


@pytest.mark.parametrize(
    ("simulator", "same"), [("turtlebot-exit", False), ("emergency-exit", True)]
)
def test_the_version_hash_covers_the_architecture_if_a_library_plays(
    simulator: str, same: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    hashes, said = [], []
    for machine in ("x86_64", "aarch64"):
        monkeypatch.setattr(
            version_hash.platform, "machine", lambda machine=machine: machine
        )
        forget()
        hashes.append(version_hash.version_hash(simulator, "fully-meshed"))
        said.append(version_hash.versions(simulator, "fully-meshed"))
    assert (hashes[0] == hashes[1]) == same
    assert version_hash.differing(*said) == (
        [] if same else ["architecture x86_64 here, aarch64 there"]
    )


def test_every_simulator_that_imports_pymunk_declares_it() -> None:
    for name in plugins.BUNDLED["simulator"]:
        files = plugins.source_files("simulator", name)
        text = "".join(file.read_text() for file in files)
        assert ("import pymunk" in text) <= ("pymunk" in plugins.libraries(files)), name


X86 = "vendor_id\t: GenuineIntel\nmodel\t\t: 207\ncpu MHz\t\t: 2100.000\nflags\t\t: fpu avx2\n"
ARM = "processor\t: 0\nBogoMIPS\t: 50.00\nFeatures\t: fp asimd\nCPU part\t: 0xd0c\n"


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        (X86, X86.replace("2100", "3500"), True),
        (X86, X86 + "\n" + X86.replace("avx2", "avx"), True),
        (X86, X86.replace("avx2", "avx"), False),
        (X86, X86.replace("207", "143"), False),
        (ARM, ARM.replace("asimd", "asimd sve"), False),
        (ARM, ARM.replace("0xd0c", "0xd40"), False),
        (ARM, "", False),
    ],
)
def test_each_kind_of_processor_has_its_own_cache(
    one: str, other: str, same: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The version hash is the same, because both compute the same."""
    monkeypatch.setattr(version_hash, "CPUINFO", tmp_path / "cpuinfo")
    before = fresh()
    hashes = []
    for text in (one, other):
        (tmp_path / "cpuinfo").write_text(text)
        hashes.append(fresh())
    assert (hashes[0] == hashes[1]) == same
    assert {problem for problem, _ in hashes} == {before[0]}


def test_an_unknown_processor_also_has_a_cache(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(version_hash, "CPUINFO", tmp_path / "none")
    assert fresh() == fresh()


def test_differences_between_two_versions_are_named(copy: Path) -> None:
    """The parts that the version hash covers are named; equal versions have no difference."""
    before = version_hash.versions("emergency-exit", "fully-meshed")
    assert version_hash.differing(before, dict(before)) == []
    for file, told in (
        ("sims/emergency_exit.py", "other code of simulator emergency-exit"),
        ("nets/fully_meshed.py", "other code of representation fully-meshed"),
        ("kernels/portable.py", "other code of zswarm"),
    ):
        text = (copy / file).read_text()
        (copy / file).write_text(text + "# a version later\n")
        forget()
        assert version_hash.differing(
            version_hash.versions("emergency-exit", "fully-meshed"), before
        ) == [told]
        (copy / file).write_text(text)
    assert version_hash.differing(
        {"numpy": "2.1.0"}, {"numpy": "2.3.0", "jax": "0.9"}
    ) == [
        "numpy 2.1.0 here, 2.3.0 there",
        "no jax here",
    ]


def test_missing_packages_are_listed_as_arguments_of_pip() -> None:
    """Packages that only one side has are listed; an invalid version is not passed on."""
    here = {"numpy": "2.1.0", "torch": "none", "vmas": "none", "scipy": "none"}
    asked = {
        "numpy": "2.3.0",
        "torch": "2.13.0+cpu",
        "vmas": "1; reboot",
        "scipy": "none",
        "jax": "0.9",
    }
    assert version_hash.lacking(here, asked) == ["torch==2.13.0+cpu", "vmas"]
    assert version_hash.lacking({"numpy": "2.1.0"}, asked) == []
