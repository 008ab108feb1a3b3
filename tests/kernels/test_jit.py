"""Check that changing any code involved, or the processor, makes cached kernels recompile."""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from types import FunctionType, SimpleNamespace

import numpy as np
import pytest

import zswarm
from tests.integration.programs import install
from tests.kernels.warming import Warmed, warmed_up
from zswarm.kernels import cache, jit
from zswarm.kernels.cache import cache_folder
from zswarm.kernels.lanes import load, store
from zswarm.nets import bulk, fully_meshed
from zswarm.plugins.version_hash import cache_hash
from zswarm.sims.epuck import trial

PACKAGE = Path(zswarm.__file__).parent
TINY = """
from zswarm.kernels.jit import array, float64, kernel, void
from zswarm.kernels.portable import sigmoid

@kernel(void(array(float64), array(float64)))
def squash(numbers, made):
    made[0] = sigmoid(numbers[0])
"""
SQUASH = """
import numpy as np
from zswarm.kernels.cache import cache_folder
from zswarm.nets.tiny import squash

made = np.empty(1)
squash(np.zeros(1), made)
print(made[0], sum(squash.dispatcher.stats.cache_hits.values()), cache_folder())
"""


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A folder with the package, which has one kernel more: little to compile."""
    shutil.copytree(
        PACKAGE,
        tmp_path / "zswarm",
        ignore=shutil.ignore_patterns("__pycache__", "examples"),
    )
    (tmp_path / "zswarm" / "nets" / "tiny.py").write_text(TINY)
    return tmp_path


def run(
    code: str, tree: Path, cache: Path, *arguments: str, **environment: str
) -> list[str]:
    """Return the words that a program prints, with the package of another tree."""
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments],
        cwd=tree,
        env={
            **os.environ,
            "PYTHONPATH": str(tree),
            "ZSWARM_CACHE": str(cache),
            "ZSWARM_PLAIN": "",
            "PYTHONDONTWRITEBYTECODE": "1",
            **environment,
        },
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


@pytest.mark.long
def test_a_change_in_a_called_file_gives_the_new_result_and_a_new_cache_folder(
    tree: Path,
) -> None:
    """The file of the kernel itself stays as it is: numba's own cache would give the old result."""
    cache = tree / "cache"
    callee = tree / "zswarm" / "kernels" / "portable.py"
    original = callee.read_text()

    result, _, folder = run(SQUASH, tree, cache)
    assert (result, Path(folder).parent) == ("0.5", cache)

    changed = original.replace(
        "return 1.0 / (1.0 + exp(-x))", "return 1.5 / (1.0 + exp(-x))"
    )
    assert changed != original
    callee.write_text(changed)
    other_result, hits, other_folder = run(SQUASH, tree, cache)
    assert (other_result, hits) == ("0.75", "0")
    assert other_folder != folder

    callee.write_text(original)
    assert run(SQUASH, tree, cache) == ["0.5", "1", folder], (
        "the first folder still serves the first code"
    )
    assert {path.name for path in cache.iterdir()} == {
        Path(folder).name,
        Path(other_folder).name,
    }


@pytest.mark.long
def test_machines_of_unlike_processors_share_a_cache_and_each_finds_its_own_kernels(
    tree: Path,
) -> None:
    """Share a cache on a network home directory.

    A kernel for a newer processor would crash the program on an older one.
    """
    cache, generic = (
        tree / "cache",
        {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""},
    )
    first, second = run(SQUASH, tree, cache), run(SQUASH, tree, cache, **generic)
    assert (first[:2], second[:2]) == (["0.5", "0"], ["0.5", "0"]), "each compiles"
    assert Path(first[2]).parent == Path(second[2]).parent == cache
    assert first[2] != second[2]
    assert run(SQUASH, tree, cache) == ["0.5", "1", first[2]]
    assert run(SQUASH, tree, cache, **generic) == ["0.5", "1", second[2]]


@pytest.mark.long
def test_kernels_are_found_wherever_the_code_is_installed_and_with_any_plugin(
    tree: Path,
) -> None:
    """A plug-in has another folder; zswarm's own kernels stay where they are."""
    cache, other = tree / "cache", tree / "other"
    shutil.copytree(tree / "zswarm", other / "zswarm")
    for file in (other / "zswarm").rglob("*.py"):
        os.utime(file, (0, 0))
    result, _, folder = run(SQUASH, tree, cache)
    assert run(SQUASH, other, cache) == [result, "1", folder]
    path = install(tree, "zswarm_more", "", "more = zswarm_more:More")
    path = os.pathsep.join([str(other), path])
    found, hits, with_plugin = run(SQUASH, other, cache, PYTHONPATH=path)
    assert (found, hits) == (result, "1")
    assert with_plugin != folder


def test_a_function_that_calls_a_plugin_is_none_of_the_bundled() -> None:
    from zswarm.kernels.compiler import is_bundled

    def step() -> None:
        """Stand for a plug-in's."""

    ours = fully_meshed.FullyMeshed.step
    for part, bundled in ((ours, True), (SimpleNamespace(py_func=step), False)):
        names = {**vars(bulk), "part_step": part}
        assert is_bundled(FunctionType(bulk.decide.__code__, names)) is bundled
    assert not is_bundled(step)
    assert is_bundled(ours.py_func)
    # ``place`` is called by ``start``, and reads an attribute that is named so.
    assert is_bundled(trial.place.py_func)


def test_warming_up_compiles_functions_that_compile_on_their_first_call(
    tmp_path: Path,
) -> None:
    """No batch waits for the compilation."""
    found = warmed_up(["lazy"], tmp_path, cache_folder().parent, "fully-meshed")
    assert found == [Warmed("lazy", "fully-meshed", compiled=True, later=0)]


def test_modules_that_numba_loads_for_the_first_kernel_are_loaded_in_advance(
    tmp_path: Path,
) -> None:
    """The fork server loads them; slots that load them themselves take 20 MB more each."""
    code = """
import sys, zswarm.evaluate, zswarm.kernels.compiler
before = set(sys.modules)
from zswarm.nets.fully_meshed import FullyMeshed
FullyMeshed.step.dispatcher
print([name for name in sys.modules if "numba" in name and name not in before])
print("numba.np.arraymath" in sys.modules)
"""
    compiling = run(code, PACKAGE.parent, tmp_path)
    assert compiling == ["[]", "True"]
    loading = run(code, PACKAGE.parent, tmp_path)
    assert loading == ["[]", "False"], "loading what is compiled needs no compiler"


@pytest.mark.parametrize("plain", ["", "1"])
def test_parts_are_imported_without_numba(tmp_path: Path, plain: str) -> None:
    code = """
import sys
from zswarm.plugins import registry as plugins
for kind in ("simulator", "representation"):
    for name in plugins.names(kind):
        plugins.load(kind, name)
print("numba" in sys.modules)
"""
    assert run(code, PACKAGE.parent, tmp_path, ZSWARM_PLAIN=plain) == ["False"]
    assert not list(tmp_path.iterdir())


def test_the_compiler_uses_the_folder_and_no_vector_library() -> None:
    done = run(
        "import zswarm.kernels.compiler; from numba import config as c; "
        "print(c.CACHE_DIR, c.DISABLE_INTEL_SVML, c.USING_SVML)",
        PACKAGE.parent,
        cache_folder().parent,
    )
    assert done == [str(cache_folder()), "1", "False"]


@pytest.fixture
def choices(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """The places that are tried, in order, all of this test."""
    monkeypatch.setenv("ZSWARM_CACHE", str(tmp_path / "own"))
    monkeypatch.setenv("CACHE_DIRECTORY", str(tmp_path / "systemd"))
    monkeypatch.setattr(
        cache.platformdirs, "user_cache_dir", lambda name: str(tmp_path / "home" / name)
    )
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return [
        tmp_path / "own",
        tmp_path / "systemd",
        tmp_path / "home/zswarm",
        tmp_path / f"zswarm-{os.getuid()}",
    ]


def test_an_unwritable_cache_folder_is_skipped_for_the_next(
    choices: list[Path],
) -> None:
    for choice in choices:
        folder = cache_folder()
        assert folder == choice / cache_hash()
        assert folder.is_dir()
        shutil.rmtree(choice)
        choice.write_text("a file, where no folder can be")
    last = cache_folder()
    assert last.is_dir()
    assert last.parent == choices[0].parent


def test_a_cache_folder_without_write_permission_is_skipped(
    choices: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    allowed = os.access
    monkeypatch.setattr(
        os,
        "access",
        lambda path, mode: "own" not in Path(path).parts and allowed(path, mode),
    )
    assert cache_folder() == choices[1] / cache_hash()


def test_unset_and_empty_cache_variables_are_ignored(
    choices: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("ZSWARM_CACHE")
    monkeypatch.setenv("CACHE_DIRECTORY", "")
    assert cache_folder() == choices[2] / cache_hash()


def test_a_user_without_a_home_gets_a_temporary_cache_folder(
    choices: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Use a temporary directory for a user without a home, such as one in a container.

    A relative path would depend on the working directory.
    """
    monkeypatch.delenv("ZSWARM_CACHE")
    monkeypatch.delenv("CACHE_DIRECTORY")
    monkeypatch.setattr(
        cache.platformdirs, "user_cache_dir", lambda name: f"~/.cache/{name}"
    )
    assert cache_folder() == choices[3] / cache_hash()

    def refuse(name: str) -> str:
        raise RuntimeError("could not determine the home directory")

    monkeypatch.setattr(cache.platformdirs, "user_cache_dir", refuse)
    assert cache_folder() == choices[3] / cache_hash()


def test_a_named_folder_is_used_if_the_temporary_folder_is_not_writable(
    choices: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse() -> str:
        raise FileNotFoundError("no usable temporary directory")

    monkeypatch.setattr(tempfile, "gettempdir", refuse)
    assert cache_folder() == choices[0] / cache_hash()


def test_the_folder_is_closed_to_other_users(choices: list[Path]) -> None:
    """Files in this folder are run as code."""
    assert cache_folder().stat().st_mode & 0o077 == 0


def test_the_cache_folder_is_used_even_if_numba_was_imported_earlier(
    tmp_path: Path,
) -> None:
    """A notebook may have; numba's own cache would give old results after a change."""
    code = (
        "import numba, zswarm.kernels.compiler; "
        "print(numba.config.CACHE_DIR, numba.config.DISABLE_INTEL_SVML)"
    )
    folder, without_svml = run(
        code, tmp_path, tmp_path / "cache", PYTHONPATH=str(PACKAGE.parent)
    )
    assert Path(folder) == tmp_path / "cache" / cache_hash()
    assert without_svml == "1"


@jit.kernel(jit.void(jit.array(jit.float32), jit.array(jit.float32)))
def roots(numbers, made):  # type: ignore[no-untyped-def]  # compiled
    """The first eight as lanes, the others one by one."""
    store(made, 0, jit.sqrt(load(numbers, 0)))
    for index in range(8, numbers.shape[0]):
        made[index] = jit.sqrt(numbers[index])


def test_square_roots_are_those_of_numpy_in_kernels_and_in_lanes() -> None:
    numbers = np.concatenate(
        [np.float32([0, 1, 2, np.inf, 1e-45]), np.arange(1000, dtype=np.float32) / 7]
    )
    made = np.empty_like(numbers)
    roots(numbers, made)
    assert made.tobytes() == jit.sqrt(numbers).tobytes() == np.sqrt(numbers).tobytes()
