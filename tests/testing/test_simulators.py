"""``check_simulator`` names the broken rule: examples of the contract with one mistake each."""

import inspect
import os
import random
import re
import signal
import sys
import textwrap
import threading
import time
from collections.abc import Iterator
from multiprocessing.shared_memory import SharedMemory
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from zswarm.kernels.random import Stream
from zswarm.sims.simulator import Body, Frame, Line, Outcome, Ray, Simulator, Turn
from zswarm.testing import check_simulator, simulators
from zswarm.testing.rules import BrokenRule

MOST_LINES = 44  # of the contract: a screen


def example() -> dict[str, Any]:
    """Return what the docstring of ``Simulator`` defines."""
    found = re.search(r"::\n\n(.*?)\n\S", inspect.getdoc(Simulator) or "", re.S)
    assert found
    names = {
        "msgspec": msgspec,
        "np": np,
        "Simulator": Simulator,
        "Stream": Stream,
        "Turn": Turn,
        "Outcome": Outcome,
    }
    exec(compile(textwrap.dedent(found[1]), "example", "exec"), names)  # noqa: S102  our own text
    return names


Gather: Any = example()["Gather"]


def test_a_whole_simulator_fits_on_one_screen_and_passes_the_check() -> None:
    """It passes, and the check says how fast it is."""
    assert len(Simulator.__doc__.splitlines()) <= MOST_LINES
    speed = check_simulator(Gather)
    assert speed.agent_steps_per_s > 1000
    assert 0 < speed.own_share <= 1
    assert re.fullmatch(
        r"Gather: [\d,]+ agent-steps/s, [\d,.]+ trials/s in turns; a turn takes .* us, \d+% of .*",
        str(speed),
    )


class DrawsFromNumpy(Gather):
    def reset(self, seed: int) -> Turn:
        turn: Turn = super().reset(seed)
        self.x[0] += np.random.rand()
        return turn


class DrawsFromRandom(Gather):
    def outcome(self) -> Outcome:
        self.drawn = getattr(self, "drawn", None) or random.random()
        return Outcome([self.drawn], [])


class LooksAtTheClock(Gather):
    def reset(self, seed: int) -> Turn:
        self.day = time.time() // 86400
        return super().reset(seed)

    def outcome(self) -> Outcome:
        return Outcome([self.day], [])


class Exits(Gather):
    def outcome(self) -> Outcome:
        sys.exit(3)


class AsksTheSystem(Gather):
    def reset(self, seed: int) -> Turn:
        self.drawn = os.urandom(1)[0]
        return super().reset(seed)

    def outcome(self) -> Outcome:
        return Outcome([self.drawn], [])


class CountsInItsClass(Gather):
    count = 0

    def outcome(self) -> Outcome:
        return Outcome([type(self).count], [])

    def reset(self, seed: int) -> Turn:
        type(self).count += 1
        return super().reset(seed)


class CountsInItself(Gather):
    count = 0

    def reset(self, seed: int) -> Turn:
        self.count += 1
        return super().reset(seed)

    def outcome(self) -> Outcome:
        return Outcome([self.count], [])


class TidiesUpAtTheEnd(Gather):
    turns = 0

    def step(self, actions: np.ndarray) -> Turn | None:
        self.turns += 1
        following: Turn | None = super().step(actions)
        if following is None:
            self.count, self.turns = self.turns, 0
        return following

    def outcome(self) -> Outcome:
        return Outcome([self.count], [])


class SeesNaN(Gather):
    def turn(self) -> Turn:
        turn: Turn = super().turn()
        turn.observations[2, 1] = np.nan
        return turn


class GivesTheSameArray(Gather):
    def turn(self) -> Turn:
        if not hasattr(self, "seen"):
            self.seen = np.zeros((3, 2), np.float32)
        self.seen[:] = super().turn().observations
        return Turn(range(3), self.seen)


class ForgetsItsOutcome(Gather):
    def outcome(self) -> Outcome:
        outcome: Outcome = super().outcome()
        self.x = self.x * 0.0
        return outcome


class GivesATuple(Gather):
    def turn(self) -> Any:
        return tuple(super().turn())


class GivesANumber(Gather):
    def outcome(self) -> Any:
        return 1.0


class NeverEnds(Gather):
    def step(self, _: np.ndarray) -> Turn:
        return self.turn()


class HasNoSettings(Gather):
    settings_type = None


class HasNoOwners(Gather):
    owners = property()


held: list[Any] = []


class KeepsMemory(Gather):
    def reset(self, seed: int) -> Turn:
        held.append(bytearray(10_000))
        return super().reset(seed)


class KeepsFilesOpen(Gather):
    def reset(self, seed: int) -> Turn:
        held.append(open(os.devnull))  # noqa: SIM115  it is to stay open
        return super().reset(seed)


class KeepsThreads(Gather):
    def reset(self, seed: int) -> Turn:
        held.append(threading.Event())
        threading.Thread(target=held[-1].wait, daemon=True).start()
        return super().reset(seed)


class KeepsProcesses(Gather):
    settings: Any

    def reset(self, seed: int) -> Turn:
        held.append(os.posix_spawn("/bin/sleep", ["sleep", "60"], {}))
        return super().reset(seed)


class SetsAnAlarm(Gather):
    def reset(self, seed: int) -> Turn:
        signal.alarm(3600)
        return super().reset(seed)


class ChangesSettings(Gather):
    def reset(self, seed: int) -> Turn:
        sys.setrecursionlimit(2345)
        os.chdir("/")
        os.environ["CHANGED"] = "1"
        return super().reset(seed)


class KeepsSharedMemory(Gather):
    def reset(self, seed: int) -> Turn:
        held.append(SharedMemory(create=True, size=10))
        return super().reset(seed)


@pytest.fixture
def let_go() -> Iterator[None]:
    """Release what the simulators above keep."""
    recursion, folder = sys.getrecursionlimit(), Path.cwd()
    yield
    signal.alarm(0)
    sys.setrecursionlimit(recursion)
    os.chdir(folder)
    os.environ.pop("CHANGED", None)
    while held:
        match held.pop():
            case int(process):
                os.kill(process, signal.SIGKILL)
                os.waitpid(process, 0)
            case threading.Event() as event:
                event.set()
            case bytearray():
                pass
            case SharedMemory() as shared:
                shared.close()
                shared.unlink()
            case file:
                file.close()


AGAIN = "played again, after other trials, has another outcome: "


@pytest.mark.usefixtures("let_go")
@pytest.mark.parametrize(
    ("broken", "text"),
    [
        (
            DrawsFromNumpy,
            AGAIN
            + "it depends on the state of the world outside; it uses the generator of numpy.random",
        ),
        (
            DrawsFromRandom,
            AGAIN
            + "it depends on the state of the world outside; it uses the generator of random; draw",
        ),
        (
            LooksAtTheClock,
            AGAIN
            + "it depends on the state of the world outside; it uses time.time; draw from",
        ),
        (
            AsksTheSystem,
            AGAIN + "new simulators differ, too; it depends on something outside",
        ),
        (
            CountsInItsClass,
            AGAIN
            + "new simulators differ, too; it depends on something outside, such as variables of",
        ),
        (
            CountsInItself,
            AGAIN + "it depends on earlier trials: initialize everything in reset",
        ),
        (
            TidiesUpAtTheEnd,
            "played again, after a trial that was abandoned, has another outcome: it depends on",
        ),
        (
            SeesNaN,
            "SeesNaN.reset: observations must be finite; number 1 of agent 2 is nan",
        ),
        (
            GivesTheSameArray,
            "GivesTheSameArray.step changes the observations of the previous turn: each turn needs",
        ),
        (ForgetsItsOutcome, "ForgetsItsOutcome.outcome, called twice, gives"),
        (
            GivesATuple,
            r"GivesATuple.reset must return a Turn, not \(range\(0, 3\), array",
        ),
        (GivesANumber, "GivesANumber.outcome must return an Outcome, not 1.0"),
        (
            NeverEnds,
            "NeverEnds: the trial continues after 300 turns: step must return None when it is over",
        ),
        (Exits, r"Exits: return None from step to end a trial; do not call exit\(3\)"),
        (
            HasNoSettings,
            "HasNoSettings.settings_type must be a frozen msgspec.Struct, not None",
        ),
        (
            HasNoOwners,
            "HasNoOwners.owners is missing: per agent the participant that drives it",
        ),
        (KeepsMemory, r"KeepsMemory: each trial leaks [\d,]+ bytes;"),
        (KeepsFilesOpen, "KeepsFilesOpen: each trial leaks 1 open files;"),
        (KeepsThreads, "KeepsThreads: each trial leaks 1 threads;"),
        (KeepsProcesses, "KeepsProcesses: each trial leaks 1 processes;"),
        (
            SetsAnAlarm,
            "SetsAnAlarm: trials leave in their process: a timer or an alarm set;",
        ),
        (
            ChangesSettings,
            "the recursion limit changed to 2345; the working folder changed to /; the environment "
            "variable CHANGED changed; restore or remove it at the end of the trial",
        ),
        (
            KeepsSharedMemory,
            r"KeepsSharedMemory: trials leave in their process: shared memory \(/psm_",
        ),
    ],
)
def test_a_broken_rule_is_named(
    broken: type[Simulator], text: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("zswarm.sims.turns.MAX_TURNS", 300)
    with pytest.raises(AssertionError, match=text):
        check_simulator(broken)


def test_a_seeded_generator_of_ones_own_and_caches_are_no_mistake() -> None:
    class Cautious(Gather):
        def __init__(self, settings: Any) -> None:
            super().__init__(settings)
            self.table: np.ndarray | None = None
            self.kept: list[bytes] = []

        def reset(self, seed: int) -> Turn:
            self.table = np.ones(100_000) if self.table is None else self.table
            # Filled by several trials.
            self.kept += [bytes(9_000)] if len(self.kept) < 25 else []
            turn: Turn = super().reset(seed)
            self.x[0] += np.random.default_rng(seed).uniform()  # portable: here only
            return turn

    check_simulator(Cautious)


def test_the_check_restores_clocks_and_generators() -> None:
    state, before = random.getstate(), time.time
    check_simulator(Gather)
    assert random.getstate() == state
    assert time.time is before


class Draws(Gather):
    """Draw one picture at the start and another from then on."""

    pictures: tuple[Any, Any]

    def frame(self) -> Any:
        return self.pictures[0 if self.left == self.settings.steps else 1]


ROBOTS = Frame(1, 1, [], [Body("robot", 0, 0, 1)] * 3)


@pytest.mark.parametrize(
    ("pictures", "text"),
    [
        (
            (ROBOTS, ROBOTS._replace(bodies=ROBOTS.bodies[:2])),
            "the same bodies, not 3 bodies (disc disc disc), 0 lines and 0 rays",
        ),
        (
            (ROBOTS, ROBOTS._replace(lines=[Line("rod", 0, 0, 1, 1)])),
            "and then 3 bodies (disc disc disc), 1 lines and 0 rays",
        ),
        (
            (
                ROBOTS,
                ROBOTS._replace(bodies=[Body("robot", 0, 0, 1, None, "square")] * 3),
            ),
            "and then 3 bodies (square square square)",
        ),
        ((ROBOTS, None), "and then no frame"),
        (
            (ROBOTS._replace(rays=[Ray(2, 0.0, 0.0, 1.0)]),) * 2,
            "a ray's sensor must be in range(0, 2), not 2",
        ),
        (
            (ROBOTS._replace(bodies=[Body("robot", 0, 0, 1, None, "round")]),) * 2,
            "a shape must be one of disc, square",
        ),  # type: ignore[arg-type]
        (("a picture",) * 2, "must return a Frame or None, not 'a picture'"),
    ],
)
def test_an_invalid_picture_is_reported(pictures: Any, text: str) -> None:
    broken = type("Drawn", (Draws,), {"pictures": pictures})
    with pytest.raises(AssertionError, match=r"^Drawn\.frame") as raised:
        check_simulator(broken)
    assert text in str(raised.value)


def in_module(name: str, source: str, **known: object) -> dict[str, Any]:
    """Return the names of a module of that name."""
    module: dict[str, Any] = {"__name__": name, "time": time, **known}
    exec(source, module)  # noqa: S102  our own
    return module


def test_clocks_that_the_compiler_reads_are_not_the_simulators() -> None:
    """It also loads libraries that read them, when it is first needed."""
    world = simulators._World()
    library = in_module("numpy.f2py", "def load():\n    return time.time()\n")
    load = {"load": library["load"]}
    compiler = in_module("numba.core", "def work():\n    return load()\n", **load)
    loading = in_module("zswarm.kernels.compiler", "def work():\n    load()\n", **load)
    with world.in_state(1):
        compiler["work"]()
        loading["work"]()
        assert world.used == set()
        library["load"]()
        assert world.used == {"time.time"}


def test_a_thread_that_ends_meanwhile_hides_no_leak_and_is_none(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of a test's own program, for example; and a simulator may replace one each trial."""
    monkeypatch.setattr(simulators, "MOST", 7)
    ends = [threading.Event() for _ in range(10)]
    for end in ends:
        threading.Thread(target=end.wait, daemon=True).start()

    def replace() -> None:
        running = threading.Event()
        threading.Thread(target=running.wait, daemon=True).start()
        if kept:
            kept.pop().set()
        kept.append(running)

    def leave() -> None:
        ends.pop().set()
        time.sleep(0.01)
        held.append(threading.Event())
        threading.Thread(target=held[-1].wait, daemon=True).start()

    kept: list[threading.Event] = []
    simulators._check_leaks(replace)
    with pytest.raises(BrokenRule, match="each trial leaks 1 threads;"):
        simulators._check_leaks(leave)
    for end in [*ends, *kept]:
        end.set()
