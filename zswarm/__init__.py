"""zswarm: evolve swarm-robot controllers on the machines you already have.

What is for users is here, and is loaded when it is used: importing zswarm costs nothing (docs/python.md).

Example::

    import zswarm

    run = zswarm.run(zswarm.load("stadium", {"generations": 50}), progress=True)
    print(run.best())
"""

from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from zswarm.api import connect, load, plot, problem, read, resume, run, start, study
    from zswarm.controller import Controller, Driver
    from zswarm.errors import ConfigError, EvaluationError, KeysError, NoServers, Stopped, UnknownPlugin, ZswarmError
    from zswarm.experiment import Experiment
    from zswarm.ot.connection import Connection, Outcomes
    from zswarm.ot.dispatch import Note
    from zswarm.ot.evolution import Evolution
    from zswarm.ot.logger import Generation, Logger, Result, Started
    from zswarm.ot.problem import Problem
    from zswarm.ot.reading import Run
    from zswarm.varied import drawn

__all__ = [
    "ConfigError",
    "Connection",
    "Controller",
    "Driver",
    "EvaluationError",
    "Evolution",
    "Experiment",
    "Generation",
    "KeysError",
    "Logger",
    "NoServers",
    "Note",
    "Outcomes",
    "Problem",
    "Result",
    "Run",
    "Started",
    "Stopped",
    "UnknownPlugin",
    "ZswarmError",
    "connect",
    "drawn",
    "load",
    "plot",
    "problem",
    "read",
    "resume",
    "run",
    "start",
    "study",
]

_HOME = {
    **dict.fromkeys(("connect", "load", "plot", "problem", "read", "resume", "run", "start", "study"), "zswarm.api"),
    **dict.fromkeys(
        ("ConfigError", "EvaluationError", "KeysError", "NoServers", "Stopped", "UnknownPlugin", "ZswarmError"), "zswarm.errors"
    ),
    "Experiment": "zswarm.experiment",
    **dict.fromkeys(("Connection", "Outcomes"), "zswarm.ot.connection"),
    **dict.fromkeys(("Controller", "Driver"), "zswarm.controller"),
    "Note": "zswarm.ot.dispatch",
    "Evolution": "zswarm.ot.evolution",
    **dict.fromkeys(("Generation", "Logger", "Result", "Started"), "zswarm.ot.logger"),
    "Problem": "zswarm.ot.problem",
    "Run": "zswarm.ot.reading",
    "drawn": "zswarm.varied",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    import importlib

    value = globals()[name] = getattr(importlib.import_module(_HOME[name]), name)
    return value


def __dir__() -> list[str]:
    return sorted({*(name for name in globals() if name.startswith("__")), *__all__})
