"""Complete the names of examples, runs and parts in a shell."""

import glob
from collections.abc import Iterable
from pathlib import Path

from click import Context, Parameter
from click.shell_completion import CompletionItem

from zswarm import experiment
from zswarm.plugins import registry

RUNS = Path("runs")


def experiments(
    _context: Context, _parameter: Parameter, typed: str
) -> list[CompletionItem]:
    """Suggest examples and experiment files; if none fits, the shell suggests its files."""
    names = sorted(path.stem for path in experiment.examples_folder().glob("*.toml"))
    files = sorted(glob.glob(glob.escape(typed) + "*.toml"))
    return _fitting([*names, *files], typed) or [CompletionItem(typed, type="file")]


def runs(_context: Context, _parameter: Parameter, typed: str) -> list[CompletionItem]:
    """Suggest runs below ``runs`` and in studies; if none fits, the shell suggests its folders."""
    try:
        found = [
            path.parent
            for depth in ("*", "*/*")
            for path in RUNS.glob(f"{depth}/run.sqlite")
        ]
    except OSError:
        found = []
    return _fitting(sorted(map(str, found)), typed) or [CompletionItem(typed, type="dir")]


def simulators(
    _context: Context, _parameter: Parameter, typed: str
) -> list[CompletionItem]:
    """Suggest simulators."""
    return _fitting(registry.names("simulator"), typed)


def parts(_context: Context, _parameter: Parameter, typed: str) -> list[CompletionItem]:
    """Suggest simulators, representations, optimizers and rankings."""
    names = {name for kind in registry.BUNDLED for name in registry.names(kind)}
    return _fitting(sorted(names), typed)


def targets(_context: Context, _parameter: Parameter, typed: str) -> list[CompletionItem]:
    """Suggest what a controller can be exported to."""
    from zswarm.robots.targets import TARGETS

    return _fitting(TARGETS, typed)


def _fitting(names: Iterable[str], typed: str) -> list[CompletionItem]:
    return [
        CompletionItem(name)
        for name in names
        if name.startswith(typed) and name.isprintable()
    ]
