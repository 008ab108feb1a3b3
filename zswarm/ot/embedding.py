"""Runs inside of a Python program: their experiment, their block and who follows them."""

import contextlib
import functools
import inspect
import logging
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, NoReturn, ParamSpec, TypeVar

import msgspec
from msgspec.structs import replace

from zswarm import experiment as experiments
from zswarm.config.decode import read
from zswarm.config.overrides import blamed, changed
from zswarm.config.studies import in_words
from zswarm.config.suggest import nearest
from zswarm.errors import ConfigError
from zswarm.experiment import Experiment
from zswarm.ot.cluster.connection import Connection
from zswarm.ot.evolution import Evolution
from zswarm.ot.logger import InBackground, Logger, Loggers
from zswarm.ot.record.folder import EXPERIMENT
from zswarm.ot.study import study as studies

Source = str | os.PathLike[str] | Mapping[str, Any] | Experiment
LOG = logging.getLogger("zswarm")

P = ParamSpec("P")
R = TypeVar("R")


def load(source: Source, changes: Mapping[str, Any]) -> tuple[Experiment, str]:
    """Load an experiment with changes, and return its name in errors too."""
    check_dict(changes, "{'optimizer.population': 100}")
    if isinstance(source, Experiment):
        if not changes:
            return source, source.name
        mapping, where = experiments.to_mapping(source), source.name
    elif isinstance(source, Mapping):
        mapping, where = dict(source), "experiment"
    elif isinstance(source, str | os.PathLike):
        file = Path(source) / EXPERIMENT
        path = file if file.is_file() else experiments.find(os.fspath(source))
        mapping, where = read(path), str(path)
    else:
        raise TypeError(
            "experiment: expected a file, the name of an example, the folder of a run, a dict or "
            f"an experiment, not {source!r}"
        )
    with named(changes, where):
        return experiments.check(changed(mapping, changes, where), where), where


def named(
    changes: Mapping[str, Any], where: str
) -> contextlib.AbstractContextManager[None]:
    """Report an error in one of the changes with its key and value instead of the source."""
    words = [(str(key), in_words({str(key): value})) for key, value in changes.items()]
    return blamed(words, where)


def hinted(function: Callable[P, R]) -> Callable[P, R]:
    """Refuse an argument that does not exist by saying where such a setting belongs."""
    known = inspect.signature(function).parameters

    @functools.wraps(function)
    def called(*arguments: P.args, **given: P.kwargs) -> R:
        for name in given.keys() - known.keys():
            raise TypeError(
                f"{name!r} is no argument of zswarm.{function.__name__}"
                f"{nearest(name, known)}, which takes "
                f"{', '.join(known)}; settings are given to zswarm.load: "
                f"zswarm.load(experiment, {_as_settings(name, given[name])!r})"
            )
        return function(*arguments, **given)

    return called


def _as_settings(name: str, value: object) -> Mapping[str, Any]:
    """Return what was perhaps meant: the first setting of that name in an experiment's file."""
    if isinstance(value, Mapping):
        return value
    for field in msgspec.structs.fields(Experiment):
        if field.name == name:
            return {name: value}
        part = getattr(field.type, "__struct_fields__", ())
        if name in part:
            return {f"{field.name}.{name}": value}
    return {"optimizer.population": 100}


def check_dict(settings: Any, example: str) -> None:
    """Refuse settings that are not a mapping."""
    if not isinstance(settings, Mapping):
        raise TypeError(f"settings: expected a dict, such as {example}, not {settings!r}")


class Block(AbstractContextManager[Evolution]):
    """A run before its ``with``. Any other use is an error that says so."""

    def __init__(self, block: AbstractContextManager[Evolution]) -> None:
        self._block = block

    def __enter__(self) -> Evolution:
        return self._block.__enter__()

    def __exit__(self, *error: Any) -> bool | None:
        return self._block.__exit__(*error)

    def __iter__(self) -> NoReturn:
        raise TypeError(_NEEDS_WITH)

    def __getattr__(self, name: str) -> NoReturn:
        raise AttributeError(
            f"no attribute {name!r}" if name.startswith("_") else _NEEDS_WITH
        )


_NEEDS_WITH = (
    "a run needs a block: `with zswarm.start(...) as evolution:`, "
    "and in it `for generation in evolution:`"
)


@contextlib.contextmanager
def evolving(
    connection: Connection | None,
    loaded: Experiment,
    begin: Callable[[Connection], AbstractContextManager[Evolution]],
) -> Iterator[Evolution]:
    """Run ``begin`` with a connection; errors get a note that says how to resume."""
    with connected(connection, loaded) as used, begin(used) as begun:
        try:
            yield begun
        except (Exception, KeyboardInterrupt) as error:
            if begun.result is None:
                error.add_note(
                    f"nothing is lost; to resume: zswarm.resume({str(begun.folder)!r})"
                )
            raise


@contextlib.contextmanager
def connected(connection: Connection | None, loaded: Experiment) -> Iterator[Connection]:
    """Open the given connection, which stays open, or the experiment's own."""
    if connection is not None:
        connection.open()
        yield connection
    else:
        with Connection(loaded.cluster) as own:
            yield own


def open_study(
    source: Source, changes: Mapping[str, Any], connection: Connection | None, out: Path
) -> studies.Study:
    """Open the study in a folder, or create one of an experiment."""
    if isinstance(source, str | os.PathLike) and studies.is_study(Path(source)):
        if changes:
            raise ConfigError(
                f"{source}: a study is resumed as it is; to change it, edit its experiment.toml"
            )
        return studies.Study.open(Path(source))
    loaded, where = load(source, changes)
    if connection is not None:
        loaded = replace(loaded, cluster=connection.options)
    return studies.Study.create(loaded, where, out)


def followers(given: Sequence[Logger] | Logger, *, progress: bool) -> Logger:
    """Return one logger for the given ones and the display."""
    if isinstance(given, Logger) or not isinstance(given, Iterable):
        given = [given]
    for logger in given:
        if not isinstance(logger, Logger):
            raise TypeError(
                f"loggers: expected instances of zswarm.Logger, not {logger!r}"
            )
    shown = _display() if progress else _Quiet()
    say = shown.on_say if progress else LOG.warning
    return Loggers([shown, *(InBackground(logger, say) for logger in given)])


class _Quiet(Logger):
    """Send lines for people to Python's ``logging``."""

    def on_say(self, line: str) -> None:
        LOG.info("%s", line)

    def on_wait(self, line: str) -> None:
        self.on_say(line)


def _display() -> Logger:
    """Return the display for a notebook, a terminal or a file."""
    shell = sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
    if type(shell).__name__ == "ZMQInteractiveShell":
        from zswarm.ot.display.notebook import NotebookDisplay

        return NotebookDisplay()
    from zswarm.ot.display.progress import display

    return display(as_json=False)
