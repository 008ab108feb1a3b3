"""Every part evolves to the same history after a kill and on four servers.

A combination of parts is played twice: on one server by a process that is killed on the way and by
another that resumes it, and on four servers undisturbed.
"""

import contextlib
import itertools
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from tests.fitting_parts import NETWORKS, evolves
from tests.integration.forks import KILLED_IN, Forks
from tests.integration.programs import Server
from tests.promise.promise import check_prefix, check_run
from zswarm import experiment
from zswarm.errors import ConfigError
from zswarm.ot.build import build
from zswarm.plugins import registry as plugins

GENERATIONS = 3
ATTEMPTS = 20  # on a busy machine, some runs end before they are killed


class Problem(NamedTuple):
    """Some 30 ms of work for a generation: less is not shared among servers."""

    simulator: str
    trials: int
    measure: str
    settings: dict[str, Any]


PROBLEMS = {
    "arena": Problem("arena", 8, "spread", {"robots": 4, "steps": 1500}),
    "box-pushing": Problem("box-pushing", 2, "way", {"steps": 100, "robots": 2}),
    "crowds": Problem(
        "emergency-exit", 8, "escaped", {"steps": 1500, "agents": {"from": 5, "to": 15}}
    ),
    "duel": Problem("minisim", 1, "steals", {"steps": 100, "teams": 2, "defenders": 0}),
    "emergency-exit": Problem("emergency-exit", 8, "escaped", {"steps": 1500}),
    "epuck": Problem("epuck", 2, "neighbours", {"seconds": 20.0, "robots": 4}),
    "food-or-poison": Problem("food-or-poison", 8, "late", {"items": 500}),
    "foraging-physical": Problem(
        "foraging-physical", 2, "way", {"steps": 100, "robots": 2, "pucks": 2}
    ),
    "gymnasium": Problem("gymnasium", 8, "steps", {"environment": "Pendulum-v1"}),
    "inverted-pendulum": Problem("inverted-pendulum", 8, "upright", {"steps": 2500}),
    "light": Problem("light", 8, "distance", {"steps": 1500}),
    "maze": Problem("maze", 8, "reached", {"steps": 1000}),
    "minisim": Problem("minisim", 8, "steals", {"steps": 600}),
    "pettingzoo": Problem("pettingzoo", 2, "steps", {"environment": "simple_v3"}),
    "simplified-emergency-exit": Problem(
        "simplified-emergency-exit", 8, "x", {"steps": 7500}
    ),
    "turtlebot-exit": Problem(
        "turtlebot-exit", 2, "distance", {"steps": 100, "robots": 2}
    ),
    "xor": Problem("xor", 2000, "correct", {}),
}
GAMES = {"duel"}
SOME = {
    "box-pushing",
    "crowds",
    "foraging-physical",
    "gymnasium",
    "pettingzoo",
    "turtlebot-exit",
}
# Not installed here: tests/sims/adapters/test_vmas.py, test_ros_programs.py.
LARGE = {"vmas", "turtlebot-exit-ros"}
# Optimizers that take scores of a tournament.
COMPETING = {"cea2d", "cmaes", "neat", "nnga", "openai-es", "random"}


class Parts(NamedTuple):
    """Name the parts of an experiment."""

    problem: str
    representation: str
    optimizer: str
    ranking: str = "absolute"

    def fit(self) -> bool:
        """Return whether the parts fit together, as documented."""
        if self.problem in GAMES and self.optimizer not in COMPETING:
            return False
        if not evolves(self.optimizer, self.representation):
            return False
        return (self.problem in GAMES) == (self.ranking != "absolute")

    def experiment(self) -> dict[str, Any]:
        """Return a small experiment."""
        simulator, trials, measure, settings = PROBLEMS[self.problem]
        optimizer_class = plugins.load("optimizer", self.optimizer)
        small = {
            "population": 6 if self.problem in GAMES else 8,
            "width": 3,
            "height": 3,
            "emitters": 2,
            "measures": [measure],
            "lows": [0.0],
            "highs": [10.0],
            "cells": [10],
        }
        known = optimizer_class.settings_type.__struct_fields__
        return {
            "name": "small",
            "seed": 4,
            "generations": GENERATIONS,
            "problem": {"simulator": simulator, "trials": trials, "settings": settings},
            "representation": {
                "kind": self.representation,
                **NETWORKS.get(self.representation, {}),
            },
            "optimizer": {"kind": self.optimizer}
            | {key: value for key, value in small.items() if key in known},
            "ranking": {"kind": self.ranking},
        }


# Few pairs of problem and representation: a slot that has played one takes up the next run of it at
# once
ONCE = [
    Parts("duel", "hebbian", "nnga", "full-tournament"),
    Parts("duel", "hebbian", "cea2d", "swiss"),
    Parts("duel", "hebbian", "random", "multi-swiss"),
    Parts("xor", "neat", "neat"),
    Parts("gymnasium", "neat", "random"),
    Parts("epuck", "feed-forward", "random"),
    Parts("pettingzoo", "neat", "neat"),
    Parts("arena", "ctrnn", "cmaes"),
    Parts("crowds", "fully-meshed", "cma-me"),  # settings differ by trial
    Parts("inverted-pendulum", "feed-forward", "pso"),
    Parts("arena", "chocolate", "pso"),
    Parts("light", "three-layer", "cuckoo"),
    Parts("simplified-emergency-exit", "bulk", "openai-es"),
    Parts("maze", "mealy", "novelty"),
    Parts("food-or-poison", "hebbian", "cmaes"),
    Parts("turtlebot-exit", "hebbian", "nnga"),
    Parts("box-pushing", "ctrnn", "cmaes"),
    Parts("foraging-physical", "fully-meshed", "map-elites"),
]


class Lab:
    """Start four servers of one slot, and optimizers."""

    def __init__(self, folder: Path, servers: Sequence[str], forks: Forks) -> None:
        self._folder, self._servers, self._forks = folder, servers, forks
        self.shared: list[int] = []  # how many servers each undisturbed run had

    def check(self, parts: Parts) -> None:
        """Play a combination in both ways."""
        folder, complete = self._folder / "-".join(parts), parts.experiment()
        undisturbed = folder / "undisturbed" / "small"
        for attempt in range(ATTEMPTS):
            killed = folder / f"killed-{attempt}" / "small"
            self._forks.run(complete, killed.parent, self._servers[:1], killed=True)
            before = check_run(killed, sample=0)
            if not before.finished:
                break
        assert not before.finished, parts
        assert KILLED_IN <= len(before.told) < GENERATIONS, parts
        self._forks.resume(killed, self._servers[:1])
        self._forks.run(complete, undisturbed.parent, self._servers)
        after, whole = check_run(killed, sample=0), check_run(undisturbed, sample=0)
        assert after.told == whole.told, parts
        assert after.outcomes == whole.outcomes, parts
        check_prefix(before, whole)
        assert len(after.servers) == 1, parts
        self.shared.append(len(whole.servers))


def pairs() -> list[tuple[str, str]]:
    """List pairs of problem and representation: all, but two each for AEC environments."""
    representations = plugins.BUNDLED["representation"]
    return [
        (problem, representation)
        for row, problem in enumerate(PROBLEMS)
        for column, representation in enumerate(representations)
        if problem not in SOME or (row + column) % (len(representations) // 2) == 0
    ]


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Lab]:
    folder = tmp_path_factory.mktemp("lab")
    with contextlib.ExitStack() as stack:
        servers = [
            stack.enter_context(
                contextlib.closing(Server(folder, f"ss-{number}", capacity=1))
            )
            for number in range(4)
        ]
        forks = stack.enter_context(Forks(folder))
        lab = Lab(folder, [server.ready().endpoint for server in servers], forks)
        yield lab
        # In a short run on a busy machine, one server may be done before others begin.
        assert not lab.shared or max(lab.shared) > 1


@pytest.mark.programs
def test_every_part_survives_a_kill_and_is_the_same_on_four_servers(lab: Lab) -> None:
    """Each with some partners; all of them with all others in the tests that are marked product."""
    for kind, entries in plugins.BUNDLED.items():
        column = ["simulator", "representation", "optimizer", "ranking"].index(kind)
        played = {
            PROBLEMS[parts.problem].simulator if kind == "simulator" else parts[column]
            for parts in ONCE
        }
        assert played == set(entries) - LARGE, f"a {kind} without a partner here"
    for parts in ONCE:
        lab.check(parts)


def fitting(problem: str, representation: str) -> list[Parts]:
    """List what fits a pair."""
    return [
        parts
        for optimizer, ranking in itertools.product(
            plugins.BUNDLED["optimizer"], plugins.BUNDLED["ranking"]
        )
        if (parts := Parts(problem, representation, optimizer, ranking)).fit()
    ]


@pytest.mark.product
@pytest.mark.parametrize(("problem", "representation"), pairs())
def test_every_compatible_combination_of_parts_runs(
    problem: str, representation: str, lab: Lab
) -> None:
    for parts in fitting(problem, representation):
        lab.check(parts)


@pytest.mark.long
def test_combinations_that_do_not_fit_are_refused_in_one_line() -> None:
    for names in itertools.product(
        ("duel", "xor"),  # a game and another: problems differ in nothing else here
        *(plugins.BUNDLED[kind] for kind in ("representation", "optimizer", "ranking")),
    ):
        parts = Parts(*names)
        if not parts.fit():
            with pytest.raises(ConfigError, match=r"^(optimizer|ranking): [^\n]+$"):
                build(
                    experiment.complete(experiment.check(parts.experiment(), "it"), "it")
                )
