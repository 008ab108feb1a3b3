"""What a shell is told while a command is typed: names of examples, runs and parts."""

import glob
from collections.abc import Iterable
from pathlib import Path

import click
from click.shell_completion import CompletionItem

RUNS = Path("runs")


def experiments(_context: click.Context, _parameter: click.Parameter, typed: str) -> list[CompletionItem]:
    """Examples and experiment files; where none fits, the shell looks for files and folders itself."""
    from zswarm import experiment

    names = sorted(path.stem for path in experiment.examples_folder().glob("*.toml"))
    files = sorted(glob.glob(glob.escape(typed) + "*.toml"))
    return _fitting([*names, *files], typed) or [CompletionItem(typed, type="file")]


def runs(_context: click.Context, _parameter: click.Parameter, typed: str) -> list[CompletionItem]:
    """Runs below ``runs``, those of its studies too; where none fits, the shell looks for folders itself."""
    try:
        found = sorted(str(path.parent) for depth in ("*", "*/*") for path in RUNS.glob(f"{depth}/run.sqlite"))
    except OSError:
        found = []
    return _fitting(found, typed) or [CompletionItem(typed, type="dir")]


def simulators(_context: click.Context, _parameter: click.Parameter, typed: str) -> list[CompletionItem]:
    """Simulators by name."""
    from zswarm import plugins

    return _fitting(plugins.names("simulator"), typed)


def parts(_context: click.Context, _parameter: click.Parameter, typed: str) -> list[CompletionItem]:
    """Simulators, representations, optimizers and rankings by name."""
    from zswarm import plugins

    return _fitting(sorted({name for kind in plugins.BUNDLED for name in plugins.names(kind)}), typed)


def targets(_context: click.Context, _parameter: click.Parameter, typed: str) -> list[CompletionItem]:
    """What a controller can be exported to."""
    from zswarm.robots.targets import TARGETS

    return _fitting(TARGETS, typed)


def _fitting(names: Iterable[str], typed: str) -> list[CompletionItem]:
    return [CompletionItem(name) for name in names if name.startswith(typed) and name.isprintable()]
