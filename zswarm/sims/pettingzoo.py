"""Environments of PettingZoo (pettingzoo.farama.org) whose agents act at the same time, and those of MPE2 (mpe2.farama.org)."""

import importlib.util
import pkgutil
import re
from typing import Annotated, Any, ClassVar

import msgspec
from msgspec import Meta

from zswarm.errors import ConfigError
from zswarm.extras import need
from zswarm.sims.environments import ParallelEnvironment, ParallelSettings, check_name, without_window

LIBRARIES = ("pettingzoo", "mpe2", "box2d", "pygame", "pygame-ce", "pymunk", "scipy")
FAMILIES = ("mpe2", "pettingzoo.butterfly", "pettingzoo.sisl", "pettingzoo.classic", "pettingzoo.atari", "pettingzoo.mpe")
VERSIONED = re.compile(r"\w+_v\d+")


class Settings(ParallelSettings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of ``[problem.settings]``."""

    environment: Annotated[
        str, Meta(description="name and version of an environment of PettingZoo or MPE2, with the parallel interface")
    ] = "simple_spread_v3"


class PettingZoo(ParallelEnvironment):
    """An environment of PettingZoo or MPE2 whose agents act at the same time.

    Observation: what an agent observes, flattened as Gymnasium does: numbers as they are, a choice of n as n, one of them 1.
        Where agents are of several types, the first number is that of the type: 0, 1, ..., in the order of the environment's
        agents. Agents that observe less than others have zeros behind it.
    Action: for a number between bounds one output, 0 the lower and 1 the upper bound, cut there; for one without bounds
        2 output - 1; for a choice of n as many outputs, the highest decides, the first of equal ones; for a bit one output, set
        above .5. Agents that set less than others leave the last outputs aside.
    Turns: all agents that are there, in the environment's order. Agents may leave, and may come.
    Start: from the trial's seed, folded to 32 bits; the generators of numpy and of Python's random are seeded with it, too.
    End: when no agent is left, or after ``steps`` steps.
    Fitness: sum or mean of the returns of the participant's agents; an agent's return is the sum of its rewards.
    Metrics: ``steps``; for each type ``return_`` and its name, the mean return of its agents. An agent's type is its name without
        the number at the end.
    """

    settings_type: ClassVar[type[msgspec.Struct]] = Settings

    def make(self, **options: Any) -> Any:
        """The environment that the settings name, one of those that are installed."""
        need("pettingzoo", "gym", "simulator pettingzoo")
        known, name = environments(), self.settings.environment
        check_name(name, known, "pettingzoo")
        without_window()
        module = need(f"{known[name]}.{name}", "gym", name)
        if not hasattr(module, "parallel_env"):
            raise ConfigError(f"pettingzoo: {name}: its agents act one after the other, it has no parallel interface")
        return module.parallel_env(**options)


def environments() -> dict[str, str]:
    """The packages of the environments that are installed, by name; no environment is imported."""
    found: dict[str, str] = {}
    for family in FAMILIES:
        installed = importlib.util.find_spec(family.partition(".")[0]) and importlib.util.find_spec(family)
        for module in pkgutil.iter_modules(list(installed.submodule_search_locations or []) if installed else []):
            if VERSIONED.fullmatch(module.name):
                found.setdefault(module.name, family)
    return found
