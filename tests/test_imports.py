"""Imports point one way, and code that computes uses nothing that differs between machines."""

import ast
import collections
import functools
import re
import subprocess
import sys
from pathlib import Path

import pytest

import zswarm
from tests.repository import REPOSITORY

PACKAGE = Path(zswarm.__file__).parent
MODULES = {
    ".".join(path.relative_to(PACKAGE).with_suffix("").parts): path
    for path in sorted(PACKAGE.rglob("*.py"))
    if path.stem != "__init__"
    and not {"examples", "templates"} & set(path.parts)  # programs
}
# What each room may import besides itself: rooms, or single modules. A module that is not in a
# folder is a room. BASE: errors, config, system.
WALLS = """
errors:
system:             errors
config:             errors protocol system
plugins:            BASE
kernels:            plugins system.temporary
protocol:           BASE
nets:               BASE kernels plugins
sims:               BASE kernels sims.toolbox
sims.adapters:      BASE sims
sims.epuck:         BASE kernels sims
sims.foreign:       BASE plugins sims
sims.toolbox:       kernels
experiment:         BASE plugins protocol
evaluate:           BASE kernels nets plugins protocol sims
probe:              evaluate kernels nets protocol sims
champion:           BASE nets plugins sims
security:           BASE protocol
session:            errors protocol security system
daemon:             BASE security session
router:             BASE daemon security session
api:                errors experiment ot ot.cluster ot.record ot.study
results:            errors ot.analysis ot.record system
ot:                 BASE champion evaluate experiment kernels ot.assessment ot.cluster
                    ot.commands.shared ot.display ot.optimizers ot.rankings ot.record ot.study
                    plugins probe protocol
ot.analysis:        BASE experiment ot.record
ot.assessment:      BASE champion experiment kernels ot.problem ot.record ot.workload
ot.cluster:         BASE experiment nets ot.evaluator ot.notes ot.problem ot.workload plugins
                    protocol security session sims
ot.commands:        BASE champion experiment kernels ot.build ot.evolution ot.analysis
                    ot.cluster ot.commands.shared ot.dashboard ot.display ot.doctor ot.estimate
                    ot.importing ot.record ot.replay ot.report ot.study plugins protocol robots
                    robots.c
ot.commands.shared: BASE experiment ot.evolution ot.logger ot.cluster ot.study plugins protocol
                    robots security session
ot.dashboard:       BASE champion experiment ot.assessment.amount ot.notes ot.analysis
                    ot.record plugins
ot.display:         BASE champion ot.logger
ot.doctor:          BASE kernels ot.cluster ot.record plugins protocol security session
ot.estimate:        BASE evaluate experiment ot.build ot.notes ot.problem ot.assessment ot.cluster
                    ot.optimizers ot.rankings ot.record plugins sims
ot.importing:       BASE champion evaluate experiment nets ot.problem ot.record plugins protocol
                    robots.argos
ot.optimizers:      BASE kernels nets
ot.rankings:        BASE
ot.record:          BASE champion experiment ot.logger ot.notes ot.workload ot.cluster
                    ot.optimizers
ot.replay:          BASE champion evaluate kernels nets ot.problem ot.record plugins sims
ot.report:          BASE champion evaluate experiment nets ot.notes ot.analysis ot.estimate
                    ot.record ot.replay plugins sims
ot.study:           BASE experiment ot.build ot.evolution ot.logger ot.notes ot.analysis ot.cluster
                    ot.display ot.estimate ot.problem ot.record ot.replay protocol
robots:             BASE champion evaluate kernels nets robots.c robots.profiles sims
robots.argos:       BASE champion nets robots.c sims.epuck
robots.c:           BASE champion kernels plugins
robots.onnx:        BASE champion kernels nets robots.c
robots.profiles:    BASE
ros.launch:         BASE champion kernels plugins robots robots.c ros.link sims sims.foreign
ros.link:           BASE robots.profiles ros.link.bridges
ros.link.bridges:   BASE ros.link
ros.simulation:     BASE kernels plugins robots.profiles ros.launch ros.link ros.link.bridges sims
ss:                 BASE daemon plugins protocol security session ss.local ss.slots ss.workers
ss.local:           BASE ss.slots ss.workers
ss.slots:           errors protocol
ss.workers:         BASE evaluate probe kernels plugins protocol security ss.slots
testing:            config evaluate kernels nets ot.optimizers plugins sims system
"""
BASE = {"errors", "config", "system"}
MAY_IMPORT = {
    room: {
        name for word in words.split() for name in (BASE if word == "BASE" else {word})
    }
    for room, words in re.findall(r"^([\w.]+):(.*(?:\n +.*)*)", WALLS, re.M)
}
ONLY_IN = {
    # docs/architecture.md gives the reasons
    "zenoh": "session ot.cluster.links ot.cluster.diagnosis ot.cluster.discovery ss.network "
    "security.refusals ros.link.over_zenoh ros.link.bridges.by_zenoh",
    "numba": "kernels.compiler kernels.vectors",
    "cryptography": "security.authority security.certificates security.install security.requests",
    "pymunk": "sims.physics",
    "prometheus_client": "ss.local.metrics",
    "matplotlib": "ot.analysis.archive ot.analysis.boxes ot.analysis.drawing ot.analysis.figures "
    "ot.commands.plot results",  # for types only
    "starlette": "ot.dashboard.app ot.dashboard.guard",
    "uvicorn": "ot.dashboard.serve",
    # A simulator must not depend on its state; environments are seeded with it.
    "random": "testing.simulators sims.adapters.environments",
    # Imported by extras.need.
    **dict.fromkeys("PIL scipy jinja2 onnx cmaes ribs threadpoolctl".split(), ""),
    **dict.fromkeys("gymnasium mpe2 pettingzoo torch vmas".split(), ""),
    **dict.fromkeys("pickle marshal shelve".split(), ""),
}
PURE = """
ot.assessment.interval ot.assessment.ocba ot.assessment.race
ot.generation ot.notes ot.workload ot.estimate.cost_model ot.study.plan ot.dashboard.servers
ot.cluster.batches ot.cluster.dispatch ot.cluster.events ot.cluster.queue
ot.cluster.remote_server ot.cluster.servers ot.cluster.verification
ot.rankings.absolute ot.rankings.full_tournament ot.rankings.multi_swiss ot.rankings.ranking
ot.rankings.swiss ot.rankings.tournament
protocol.codec protocol.keys protocol.labels protocol.messages
ros.simulation.lock_step ros.simulation.pairing
ss.slots.events ss.slots.jobs ss.slots.leases ss.slots.reply_cache ss.slots.table
""".split()
IMPURE = set(
    "asyncio datetime multiprocessing os psutil queue select selectors socket subprocess threading "
    "time".split()
)
# NumPy's functions that are exact or round once, and so give the same bits everywhere; and types.
NUMPY_IN_KERNELS = set(
    "abs arange empty floor full isnan maximum minimum ones sqrt zeros zeros_like inf nan bool_ "
    "float32 float64 int8 int16 int32 int64 uint8 uint16 uint32 uint64".split()
)
TRANSCENDENTAL = set(
    "exp exp2 expm1 log log2 log10 log1p sin cos tan sinh cosh tanh sinc arcsin arccos arctan "
    "arctan2 arcsinh arccosh arctanh asin acos atan atan2 power float_power pow cbrt hypot "
    "logaddexp logaddexp2 i0 random".split()
)
REORDERING = set(
    "dot vdot matmul inner outer einsum tensordot convolve correlate linalg fft sum nansum mean "
    "average std var prod cumsum cumprod trace interp norm".split()
)


# ---- walls


@functools.cache
def imported(path: Path) -> tuple[str, ...]:
    """Return the full names that a file imports anywhere, also inside of functions."""
    names: list[str] = []
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names += (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path.name}: imports are absolute"
            names += [
                str(node.module),
                *(f"{node.module}.{alias.name}" for alias in node.names),
            ]
    return tuple(names)


def room(module: str) -> str:
    return module.rpartition(".")[0] or module


def own(path: Path) -> set[str]:
    """Return the modules of the package that a file imports."""
    names = {
        name.removeprefix("zswarm.")
        for name in imported(path)
        if name.startswith("zswarm.")
    }
    return names & set(MODULES)


@pytest.mark.parametrize("module", MODULES)
def test_imports_stay_within_the_walls(module: str) -> None:
    allowed = MAY_IMPORT[room(module)] | {room(module)}
    for target in own(MODULES[module]):
        assert {target, room(target)} & allowed, f"{module} must not import {target}"


def test_every_allowed_import_is_used() -> None:
    """A room or module in the table that is no longer imported is removed from it."""
    used = collections.defaultdict(set)
    for module, path in MODULES.items():
        for target in own(path):
            used[room(module)] |= {target, room(target)}
    assert set(MAY_IMPORT) == {room(module) for module in MODULES}
    wide = {name: allowed - BASE - used[name] for name, allowed in MAY_IMPORT.items()}
    assert {name: unused for name, unused in wide.items() if unused} == {}


def test_no_module_is_imported_circularly() -> None:
    """Imports inside of functions and under TYPE_CHECKING count, too."""
    waiting = {module: own(path) - {module} for module, path in MODULES.items()}
    while free := {
        module for module, targets in waiting.items() if not targets & set(waiting)
    }:
        waiting = {
            module: targets for module, targets in waiting.items() if module not in free
        }
    assert not waiting


def test_a_class_name_is_in_one_module_only() -> None:
    homes = collections.defaultdict(set)
    for module, path in MODULES.items():
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                homes[node.name].add(module)
    assert {name: modules for name, modules in homes.items() if len(modules) > 1} == {}


def test_files_and_functions_are_short() -> None:
    long = []
    for module, path in MODULES.items():
        text = path.read_text()
        if text.count("\n") > 400:
            long.append(module)
        long += [
            f"{module}.{node.name}"
            for node in ast.walk(ast.parse(text))
            if isinstance(node, ast.FunctionDef) and node.end_lineno - node.lineno >= 60
        ]
    assert long == []


def test_the_import_test_finds_the_modules() -> None:
    expected = {
        "errors",
        "evaluate",
        "nets.fully_meshed",
        "ot.optimizers.nnga",
        "ss.server",
    }
    assert expected <= set(MODULES)
    assert "sims.simulator" in own(MODULES["evaluate"])
    assert "protocol.keys" in own(MODULES["experiment"])


def test_the_errors_import_nothing() -> None:
    assert imported(MODULES["errors"]) == ()


@pytest.mark.parametrize("library", ONLY_IN)
def test_a_library_is_imported_only_where_it_belongs(library: str) -> None:
    users = {
        module
        for module, path in MODULES.items()
        if library in {name.split(".")[0] for name in imported(path)}
    }
    assert users == set(ONLY_IN[library].split())


def test_the_document_names_the_files_that_import_zenoh() -> None:
    prose = " ".join(
        (REPOSITORY / "docs" / "architecture.md").read_text(encoding="utf-8").split()
    )
    (sentence,) = re.findall(r"`zenoh` is imported in (.*?) only", prose)
    named = re.findall(r"`(.*?)\.py`", sentence)
    assert {name.replace("/", ".") for name in named} == set(ONLY_IN["zenoh"].split())


@pytest.mark.parametrize("module", PURE)
def test_pure_modules_import_no_clock_thread_or_network(module: str) -> None:
    assert not {name.split(".")[0] for name in imported(MODULES[module])} & IMPURE


def test_only_tests_import_the_checks() -> None:
    users = {
        module for module, path in MODULES.items() if "testing" in map(room, own(path))
    }
    assert {room(module) for module in users} <= {"testing"}


def test_the_tables_of_parts_name_modules_and_import_none() -> None:
    assert own(MODULES["plugins.registry"]) == {
        "errors",
        "plugins.distributions",
        "plugins.manifests",
        "config.suggest",
    }


def printed(code: str) -> str:
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stderr == ""
    return done.stdout


@pytest.mark.parametrize(
    "module",
    "ss.server ss.slots.table ot.cluster.shell ot.cluster.dispatch experiment "
    "protocol.codec".split(),
)
def test_programs_that_evaluate_nothing_do_not_load_the_compiler(module: str) -> None:
    """It takes a second and 80 MB."""
    assert (
        printed(f"import sys, zswarm.{module}; print('numba' in sys.modules)")
        == "False\n"
    )


def test_a_list_of_runs_is_read_without_numpy() -> None:
    """It takes a tenth of a second, a third of the command."""
    code = "import sys, zswarm.ot.commands.list, zswarm.ot.record.summary"
    assert printed(f"{code}; print('numpy' in sys.modules)") == "False\n"


def test_a_run_does_not_load_log_libraries_before_it_needs_them() -> None:
    """They load all of rich."""
    code = (
        "import sys, zswarm.ot.evolution; print({'structlog', 'rich'} & set(sys.modules))"
    )
    assert printed(code) == "set()\n"


# ---- arithmetic


def differing(source: str) -> list[str]:
    """Return what in a module of nets or sims may give other bits on another machine."""
    tree = ast.parse(source)
    found = []
    for node in ast.walk(tree):
        match node:
            case ast.Import(names=names) if {"math", "cmath", "scipy"} & {
                name.name.split(".")[0] for name in names
            }:
                found.append("import of math")
            case ast.ImportFrom(module="math" | "cmath" | "numpy" | "scipy" as module):
                found.append(f"import from {module}")
            case ast.Attribute(value=ast.Name("math"), attr=name):
                found.append(f"math.{name}")
            case ast.Attribute(value=ast.Name("np" | "numpy"), attr=name) if (
                name in TRANSCENDENTAL | {"linalg", "fft"}
            ):
                found.append(f"np.{name}")
            case ast.BinOp(op=ast.MatMult()) | ast.AugAssign(op=ast.MatMult()):
                found.append("@")
            case ast.FunctionDef() if is_kernel(node):
                found += differing_in_kernel(node)
    return found


def is_kernel(function: ast.FunctionDef) -> bool:
    names = (
        decorator.func if isinstance(decorator, ast.Call) else decorator
        for decorator in function.decorator_list
    )
    return any(
        isinstance(name, ast.Name) and name.id in ("kernel", "inline") for name in names
    )


def differing_in_kernel(function: ast.FunctionDef) -> list[str]:
    found = []
    for node in ast.walk(function):
        match node:
            case ast.Attribute(value=ast.Name("np" | "numpy"), attr=name) if (
                name not in NUMPY_IN_KERNELS
            ):
                found.append(f"np.{name} in {function.name}")
            case ast.Attribute(attr=name) if name in REORDERING:
                found.append(f".{name} in {function.name}")
            case ast.Call(func=ast.Name("sum" | "pow" as name)):
                found.append(f"{name}() in {function.name}")
            case ast.BinOp(op=ast.Pow()) | ast.AugAssign(op=ast.Pow()):
                found.append(f"** in {function.name}")
    return found


SEEDING = {"sims.adapters.environments"}  # seeds environments of other packages
COMPUTING = [
    module
    for module in MODULES
    if module.split(".")[0] in ("nets", "sims", "kernels")
    and module not in ONLY_IN["numba"].split()
]


@pytest.mark.parametrize("module", COMPUTING)
def test_networks_and_simulators_compute_the_same_bits_everywhere(module: str) -> None:
    assert differing(MODULES[module].read_text()) == (
        ["np.random"] if module in SEEDING else []
    )


def test_the_import_test_finds_the_kernels() -> None:
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


def test_the_compiler_uses_neither_fast_math_nor_threads() -> None:
    source = "".join(
        MODULES[module].read_text() for module in ("kernels.jit", "kernels.compiler")
    )
    assert "fastmath" not in source.replace("no fast-math", "")
    assert "parallel" not in source
    assert source.count("numba.njit(") == 1
