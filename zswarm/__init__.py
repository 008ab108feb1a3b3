"""zswarm: evolve swarm-robot controllers on the machines you already have.

The names for users are imported when they are used, so ``import zswarm`` is fast (docs/python.md).

Example::

    import zswarm

    run = zswarm.run(zswarm.load("stadium", {"generations": 50}), progress=True)
    print(run.best())
"""

from typing import TYPE_CHECKING, Any

from zswarm.system.version import VERSION

__version__ = VERSION

if TYPE_CHECKING:
    from zswarm.api import connect, load, problem, read, resume, run, start, study
    from zswarm.champion.controller import Controller, Driver
    from zswarm.champion.held_out import HeldOut, Tracked
    from zswarm.errors import (
        ConfigError,
        EvaluationError,
        KeysError,
        NoServers,
        Stopped,
        UnknownPlugin,
        ZswarmError,
    )
    from zswarm.experiment import Experiment
    from zswarm.ot.cluster.connection import Connection
    from zswarm.ot.evaluator import CandidateOutcomes
    from zswarm.ot.evolution import Evolution
    from zswarm.ot.logger import Generation, Logger, Result, Started
    from zswarm.ot.notes import Note
    from zswarm.ot.problem import Problem
    from zswarm.ot.record.reader import Run
    from zswarm.results import Compared, compare, plot, tidy
    from zswarm.sims.randomized import drawn

__all__ = [
    "compare",
    "connect",
    "load",
    "plot",
    "problem",
    "read",
    "resume",
    "run",
    "start",
    "study",
    "tidy",
]
__all__ += ["ConfigError", "EvaluationError", "KeysError", "NoServers", "Stopped"]
__all__ += ["UnknownPlugin", "ZswarmError"]
__all__ += [
    "CandidateOutcomes",
    "Connection",
    "Controller",
    "Driver",
    "Evolution",
    "Experiment",
    "Generation",
    "HeldOut",
    "Logger",
]
__all__ += ["Compared", "Note", "Problem", "Result", "Run", "Started", "Tracked", "drawn"]

_HOME = {
    "CandidateOutcomes": "ot.evaluator",
    "Compared": "results",
    "Connection": "ot.cluster.connection",
    "Controller": "champion.controller",
    "Driver": "champion.controller",
    "Evolution": "ot.evolution",
    "Experiment": "experiment",
    "Generation": "ot.logger",
    "HeldOut": "champion.held_out",
    "Logger": "ot.logger",
    "Note": "ot.notes",
    "Problem": "ot.problem",
    "Result": "ot.logger",
    "Run": "ot.record.reader",
    "Started": "ot.logger",
    "Tracked": "champion.held_out",
    "compare": "results",
    "drawn": "sims.randomized",
    "plot": "results",
    "tidy": "results",
}


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    import importlib

    home = _HOME.get(name, "errors" if name[0].isupper() else "api")
    value = globals()[name] = getattr(importlib.import_module(f"zswarm.{home}"), name)
    return value


def __dir__() -> list[str]:
    return sorted({*(name for name in globals() if name.startswith("__")), *__all__})
