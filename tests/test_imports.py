"""Imports point one way, and code that computes uses nothing that differs between machines.

The arrows: errors <- protocol, nets, sims <- evaluate <- ot, ss. ``ot`` and ``ss`` meet only in ``protocol``; ``nets`` and
``sims`` do not know each other. A new module or package gets its line in ``MAY_IMPORT``.
"""

import ast
import functools
import re
import subprocess
import sys
from pathlib import Path

import pytest

import zswarm

PACKAGE = Path(zswarm.__file__).parent
MODULES = {
    ".".join(path.relative_to(PACKAGE).with_suffix("").parts): path
    for path in sorted(PACKAGE.rglob("*.py"))
    if path.stem != "__init__" and not {"examples", "templates"} & set(path.parts)  # programs of their own
}
LEAVES = {
    *("draws", "endpoint", "errors", "extras", "files", "jit", "lanes", "log", "notify", "manifests", "nearest", "plugins"),
    *("portable", "ranges", "screen", "settings_sheet", "strict", "toml_line", "version_hash"),
}
MAY_IMPORT = {
    "leaf": {"leaf"},
    "protocol": {"errors", "protocol"},
    "nets": {"leaf", "nets"},
    "sims": {"leaf", "sims"},
    "sims.foreign": {"leaf", "protocol", "sims", "sims.foreign_program"},
    "sims.foreign_program": {"leaf", "protocol", "sims"},
    "labels": {"leaf", "protocol"},
    "experiment": {"leaf", "labels", "protocol"},
    "varied": {"leaf", "sims"},
    "evaluate": {"leaf", "protocol", "nets", "sims", "varied"},
    "controller": {"leaf", "protocol", "nets"},
    "robots": {"leaf", "nets", "sims", "controller", "evaluate", "robots", "ros.profiles"},
    "ros.profiles": {"leaf"},
    "ros": {"leaf", "protocol", "nets", "sims", "sims.foreign", "controller", "robots", "ros", "ros.profiles"},
    "session": {"leaf", "protocol", "security"},
    "router": {"leaf", "session", "security"},
    "security": {"leaf", "protocol", "security"},
    "ot.optimizers": {"leaf", "nets", "ot.optimizers"},
    "ot.rankings": {"leaf", "ot.rankings"},
    "ot": {
        *("leaf", "protocol", "nets", "sims", "varied", "evaluate", "experiment", "labels", "session", "security"),
        *("controller", "robots", "ot", "ot.optimizers", "ot.rankings"),
    },
    "api": {"leaf", "experiment", "ot"},
    "ss": {"leaf", "protocol", "evaluate", "labels", "session", "security", "ss"},
    "simulator_checks": {"leaf", "nets", "sims", "evaluate"},
    "testing": {"leaf", "nets", "simulator_checks", "ot.optimizers"},
}
ONLY_IN = {
    "zenoh": {
        "session",
        "ot.cluster",
        "ot.discovery",
        "ss.presence",
        "security.refusals",
        "ros.over_zenoh",
        "ros.bridges.by_zenoh",
    },  # docs/architecture.md says why
    "numba": {"jit", "lanes"},
    "cryptography": {"security.authority", "security.certificates", "security.bundle", "security.install"},
    "pymunk": {"sims.robot_world"},
    "prometheus_client": {"ss.metrics"},
    "matplotlib": {"ot.figures", "ot.reading", "api"},  # for their types; it is imported by extras.need, as are scipy and jinja2
    "PIL": set(),
    "scipy": set(),
    "jinja2": set(),
    "onnx": set(),
    "starlette": {"ot.dashboard.app", "ot.dashboard.guard"},
    "uvicorn": {"ot.dashboard.serve"},
    "cmaes": set(),  # the packages of optimizers, likewise
    "ribs": set(),
    "threadpoolctl": set(),
    "pickle": set(),
    "marshal": set(),
    "shelve": set(),
    "random": {"simulator_checks", "sims.environments"},  # whose state a simulator must not hang on, or is seeded for it
    "gymnasium": set(),  # environments of other packages, by extras.need
    "mpe2": set(),
    "pettingzoo": set(),
    "torch": set(),
    "vmas": set(),
}
PURE = (
    *("ot.assessment", "ot.cost_model", "ot.dispatch", "ot.plan", "ot.requests", "ot.verification", "ot.waiting", "ot.workload"),
    "ot.dashboard.fleet",
    *("ss.slots", "ss.kept", "ot.rankings.absolute", "ot.rankings.full_tournament", "ot.rankings.multi_swiss"),
    *("ot.rankings.ranking", "ot.rankings.swiss", "ot.rankings.tournament"),
    *("protocol.codec", "protocol.keys", "protocol.messages", "labels", "ros.lock_step", "ros.readings"),
)
WORLDLY = {"asyncio", "multiprocessing", "os", "queue", "select", "socket", "subprocess", "threading", "time", "datetime"}

# The only functions of numpy that are exact, or that round once, and so give the same bits everywhere; and types.
NUMPY_IN_KERNELS = {
    *("abs", "arange", "empty", "full", "isnan", "maximum", "minimum", "ones", "sqrt", "zeros", "zeros_like"),
    *("float32", "float64", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64", "bool_"),
    *("inf", "nan"),
}
TRANSCENDENTAL = {
    *("exp", "exp2", "expm1", "log", "log2", "log10", "log1p", "sin", "cos", "tan", "sinh", "cosh", "tanh", "sinc"),
    *("arcsin", "arccos", "arctan", "arctan2", "arcsinh", "arccosh", "arctanh", "asin", "acos", "atan", "atan2"),
    *("power", "float_power", "pow", "cbrt", "hypot", "logaddexp", "logaddexp2", "i0", "random"),
}
REORDERING = {
    *("dot", "vdot", "matmul", "inner", "outer", "einsum", "tensordot", "convolve", "correlate", "linalg", "fft"),
    *("sum", "nansum", "mean", "average", "std", "var", "prod", "cumsum", "cumprod", "trace", "interp", "norm"),
}


# ---- arrows -------------------------------------------------------------------------------------------------------


@functools.cache
def imported(path: Path) -> tuple[str, ...]:
    """Full names of the modules that a file imports anywhere, also inside functions."""
    names: list[str] = []
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names += (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path.name}: imports are absolute"
            names += [str(node.module), *(f"{node.module}.{alias.name}" for alias in node.names)]
    return tuple(names)


def group(module: str) -> str:
    """Where a module of the package stands in ``MAY_IMPORT``."""
    if module in LEAVES:
        return "leaf"
    parts = module.split(".")
    for length in (2, 1):
        if ".".join(parts[:length]) in MAY_IMPORT:
            return ".".join(parts[:length])
    raise AssertionError(f"{module}: give it a line in MAY_IMPORT of {Path(__file__).name}")


def own(path: Path) -> set[str]:
    """Modules of the package that a file imports."""
    names = {name.removeprefix("zswarm.") for name in imported(path) if name.startswith("zswarm.")}
    return {name for name in names if name in MODULES}


@pytest.mark.parametrize("module", MODULES)
def test_imports_follow_the_arrows(module: str) -> None:
    allowed = MAY_IMPORT[group(module)]
    for target in own(MODULES[module]):
        assert group(target) in allowed or target in allowed, f"zswarm.{module} must not import zswarm.{target}"


def test_the_arrows_have_no_circle() -> None:
    """Nobody is reached from where they may be imported."""
    done: list[str] = []
    rest = {name: {"leaf" if target in LEAVES else target for target in targets} for name, targets in MAY_IMPORT.items()}
    while rest:
        free = [name for name, targets in rest.items() if targets <= {*done, name}]
        assert free, f"a circle among {sorted(rest)}"
        done += free
        rest = {name: targets for name, targets in rest.items() if name not in free}


def test_modules_are_found() -> None:
    assert {"errors", "evaluate", "nets.fully_meshed", "ot.optimizers.nnga", "ss.server"} <= set(MODULES)
    assert "sims.simulator" in own(MODULES["evaluate"])
    assert "protocol.keys" in own(MODULES["experiment"])


def test_the_errors_import_nothing() -> None:
    assert imported(MODULES["errors"]) == ()


@pytest.mark.parametrize("library", ONLY_IN)
def test_a_library_is_imported_only_where_it_belongs(library: str) -> None:
    users = {module for module, path in MODULES.items() if library in {name.split(".")[0] for name in imported(path)}}
    assert users == ONLY_IN[library]


def test_the_document_names_the_files_that_import_zenoh() -> None:
    prose = " ".join((Path(__file__).parents[1] / "docs" / "architecture.md").read_text(encoding="utf-8").split())
    (sentence,) = re.findall(r"`zenoh` is imported in (.*?) only", prose)
    named = {name.removesuffix(".py").replace("/", ".") for name in re.findall(r"`(.*?)`", sentence)}
    assert named == ONLY_IN["zenoh"]


@pytest.mark.parametrize("module", PURE)
def test_pure_modules_know_no_clock_thread_or_network(module: str) -> None:
    assert not {name.split(".")[0] for name in imported(MODULES[module])} & WORLDLY


def test_nothing_but_tests_imports_the_checks() -> None:
    assert [module for module, path in MODULES.items() if {"testing", "simulator_checks"} & own(path)] == ["testing"]


def test_the_tables_of_parts_name_modules_and_import_none() -> None:
    assert own(MODULES["plugins"]) == {"errors", "manifests", "nearest"}


@pytest.mark.parametrize("module", ["ss.server", "ss.slots", "ot.cluster", "ot.dispatch", "experiment", "protocol.codec"])
def test_what_evaluates_nothing_runs_without_the_compiler(module: str) -> None:
    """It takes a second and 80 MB."""
    code = f"import sys, zswarm.{module}; print('numba' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == ("False\n", "")


def test_a_run_that_is_not_refused_waits_for_no_logs() -> None:
    """They bring all of rich."""
    code = "import sys, zswarm.ot.evolution; print({'structlog', 'rich'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == ("set()\n", "")


# ---- arithmetic ---------------------------------------------------------------------------------------------------


def differing(source: str) -> list[str]:
    """What in a module of nets or sims may give other bits on another machine."""
    tree = ast.parse(source)
    found = []
    for node in ast.walk(tree):
        match node:
            case ast.Import(names=names) if {"math", "cmath", "scipy"} & {name.name.split(".")[0] for name in names}:
                found.append("import of math")
            case ast.ImportFrom(module="math" | "cmath" | "numpy" | "scipy" as module):
                found.append(f"import from {module}")
            case ast.Attribute(value=ast.Name("math"), attr=name):
                found.append(f"math.{name}")
            case ast.Attribute(value=ast.Name("np" | "numpy"), attr=name) if name in TRANSCENDENTAL | {"linalg", "fft"}:
                found.append(f"np.{name}")
            case ast.BinOp(op=ast.MatMult()) | ast.AugAssign(op=ast.MatMult()):
                found.append("@")
            case ast.FunctionDef() if is_kernel(node):
                found += differing_in_kernel(node)
    return found


def is_kernel(function: ast.FunctionDef) -> bool:
    names = (decorator.func if isinstance(decorator, ast.Call) else decorator for decorator in function.decorator_list)
    return any(isinstance(name, ast.Name) and name.id in ("kernel", "inline") for name in names)


def differing_in_kernel(function: ast.FunctionDef) -> list[str]:
    found = []
    for node in ast.walk(function):
        match node:
            case ast.Attribute(value=ast.Name("np" | "numpy"), attr=name) if name not in NUMPY_IN_KERNELS:
                found.append(f"np.{name} in {function.name}")
            case ast.Attribute(attr=name) if name in REORDERING:
                found.append(f".{name} in {function.name}")
            case ast.Call(func=ast.Name("sum" | "pow" as name)):
                found.append(f"{name}() in {function.name}")
            case ast.BinOp(op=ast.Pow()) | ast.AugAssign(op=ast.Pow()):
                found.append(f"** in {function.name}")
    return found


SEEDING = {"sims.environments"}  # numpy's generator, for environments of other packages
COMPUTING = [module for module in MODULES if group(module) in ("nets", "sims") or module in ("portable", "lanes", "draws")]


@pytest.mark.parametrize("module", COMPUTING)
def test_networks_and_simulators_compute_the_same_bits_everywhere(module: str) -> None:
    assert differing(MODULES[module].read_text()) == (["np.random"] if module in SEEDING else [])


def test_there_are_kernels_to_look_at() -> None:
    kernels = [
        node.name
        for module in COMPUTING
        for node in ast.walk(ast.parse(MODULES[module].read_text()))
        if isinstance(node, ast.FunctionDef) and is_kernel(node)
    ]
    assert {"step", "play_trials", "exp", "judge"} <= set(kernels)


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("import math", True),
        ("from math import exp", True),
        ("from numpy import tanh", True),
        ("y = math.floor(x)", True),
        ("y = np.exp(x)", True),
        ("y = np.arctan2(x, x)", True),
        ("y = np.linalg.norm(x)", True),
        ("y = a @ b", True),
        ("a @= b", True),
        ("y = np.sqrt(x)", False),
        ("y = np.sum(x)", False),
        ("y = a * b", False),
        ("@inline\ndef f(x):\n    return np.sqrt(x) * np.float32(2)", False),
        ("@inline\ndef f(x):\n    return np.sum(x)", True),
        ("@inline\ndef f(x):\n    return x.sum()", True),
        ("@inline\ndef f(x):\n    return sum(x)", True),
        ("@kernel(void())\ndef f(x):\n    return np.dot(x, x)", True),
        ("@kernel(void())\ndef f(x):\n    return x ** 0.5", True),
        ("@kernel(void())\ndef f(x):\n    return np.floor_divide(x, x)", True),
        ("def f(x):\n    return x ** 2", False),
    ],
)
def test_the_check_finds_what_differs(line: str, found: bool) -> None:
    assert bool(differing(line)) == found


def test_the_compiler_is_asked_for_nothing_loose() -> None:
    source = MODULES["jit"].read_text()
    assert "fastmath" not in source.replace("no fast-math", "")
    assert "parallel" not in source
    assert source.count("numba.njit(") == 3, "all kernels go through kernel(), for decisions apart, and inline()"
