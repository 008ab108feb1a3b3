"""The check that a simulator keeps its contract.

It plays trials with random networks: repeatedly, in another order, after a trial that was cut
short, and with clocks and generators in another state. It also looks for resources that leak.
"""

import contextlib
import copy
import gc
import random
import sys
import time
import tracemalloc
from collections.abc import Callable, Iterator, Mapping
from types import FrameType
from typing import Any
from unittest import mock

import numpy as np
import psutil

from zswarm.config.decode import convert, is_struct
from zswarm.evaluate import evaluate, turns
from zswarm.kernels.lanes import LANES
from zswarm.kernels.random import Stream
from zswarm.nets.networks import Networks
from zswarm.nets.representation import Representation
from zswarm.sims.simulator import CompiledSimulator, Simulator
from zswarm.sims.turns import BrokenContractError, play_turns
from zswarm.system import shared_memory
from zswarm.system.process_state import left_behind, process_state
from zswarm.testing.proxies import CheckedSimulator, Speed, TimedSimulator
from zswarm.testing.rules import BrokenRule, checking, fully_meshed, lint, require

__all__ = ["Speed", "check_simulator"]

TRIAL_SEEDS = (0, 1, 2**63 + 5, 2**64 - 1)
LEAST, MOST = 6, 30  # repetitions to find leaks: at least; at most, while each leaks more
LEAK_BYTES = 4096  # smallest leak of a trial that is reported
LATER_S = 1e6
CLOCKS = {  # ticks per second
    "time": 1.0,
    "time_ns": 1e9,
    "monotonic": 1.0,
    "monotonic_ns": 1e9,
    "perf_counter": 1.0,
    "perf_counter_ns": 1e9,
}


def check_simulator(
    simulator_class: type[Simulator], settings: Mapping[str, Any] | None = None
) -> Speed:
    """Play trials with random fully-meshed networks and check the contract of ``Simulator``.

    - The numbers and names that the class states fit together.
    - Agents, shape and dtype of each turn are right; observations are finite and stay as they are.
    - The outcome has the right lengths and is finite.
    - A seed gives the same bits again: after other trials, after one that was abandoned, in another
      instance, at another time, whatever the state of ``random`` and ``numpy.random``.
    - No trial leaks memory, open files, threads or processes.
    - No trial leaves timers or shared memory, or changes limits, signal handling, the recursion
      limit, the umask, the working folder or environment variables.
    - A ``CompiledSimulator`` gives the same bits in its turns, in a batch, and trial by trial, and
      reports its progress and stops on request.

    A ``PortabilityWarning`` names each line of a ``repeatable`` simulator with a function whose
    bits differ between machines (numpy's sums, ``@``, ``np.random``, sines ...), and what to use
    instead. A comment ``# portable: reason`` silences a line.

    Args:
        simulator_class: the class to check.
        settings: of the problem, as in ``[problem.settings]``; defaults where omitted.

    Returns:
        The speed in turns; printed, it is a sentence.

    Raises:
        AssertionError: a rule is broken; the text names it.
    """
    kind = getattr(simulator_class, "settings_type", None)
    text = f".settings_type must be a frozen msgspec.Struct, not {kind!r:.80}"

    def new() -> Simulator:
        return simulator_class(
            convert(settings or {}, simulator_class.settings_type, "settings")
        )

    with checking(simulator_class.__name__):
        require(is_struct(kind) and kind.__struct_config__.frozen, text)
        speed = _check(new)
    lint(new())
    return speed


def _check(new: Callable[[], Simulator]) -> Speed:
    checked = CheckedSimulator(new())
    trials = _CheckedTrials(new, checked.simulator)
    with trials.world.in_state(1), _leaving_nothing():
        trials.expected = [
            trials.play(checked, trial) for trial in range(len(trials.seeds))
        ]
    fresh = new()
    timed = TimedSimulator(fresh)
    begin = time.process_time()
    with trials.world.in_state(2):
        for trial in reversed(range(len(trials.seeds))):
            trials.check_again(timed, trial, "after other trials")
        speed = timed.speed(time.process_time() - begin, len(trials.seeds))
        trials.abandon(fresh)
        trials.check_again(fresh, 1, "after a trial that was abandoned")
    _check_leaks(lambda: trials.play(fresh, 1))
    if isinstance(fresh, CompiledSimulator):
        trials.check_compiled(fresh)
    return speed


class _CheckedTrials:
    """The trials that are played again and again.

    Attributes:
        participants: (trials, participants) int64, indices into genomes.
        expected: per trial the bytes of its fitness and metrics.
    """

    def __init__(self, new: Callable[[], Simulator], simulator: Simulator) -> None:
        self.new, self.world = new, _World()
        self.metrics = len(simulator.metrics)
        self.network = fully_meshed(simulator.inputs, simulator.outputs)
        self.genomes = self.network.random(simulator.participants + 2, Stream(1))
        self.parameters = self.network.parameters(self.genomes)
        rows = np.repeat(np.arange(len(self.genomes)), len(TRIAL_SEEDS))[:, None]
        self.participants = (rows + np.arange(simulator.participants)) % len(self.genomes)
        self.seeds = np.array(TRIAL_SEEDS * len(self.genomes), np.uint64)
        self.expected: list[bytes] = []

    def play(self, player: Simulator, trial: int) -> bytes:
        """Play a trial in turns; return the bytes of its fitness and metrics."""
        parameters = self.parameters[self.participants[trial]]
        seed = int(self.seeds[trial])
        fitness, metrics = np.zeros(len(parameters)), np.zeros(self.metrics)
        controllers = Networks(self.network, parameters)
        try:
            play_turns(player, controllers, seed, fitness, metrics)
        except BrokenContractError as error:
            raise BrokenRule(f": {error}") from None
        except SystemExit as error:
            text = (
                f": return None from step to end a trial; do not call exit({error.code})"
            )
            raise BrokenRule(text) from error
        return fitness.tobytes() + metrics.tobytes()

    def abandon(self, player: Simulator) -> None:
        """Play two turns of a trial."""
        parameters = self.parameters[self.participants[0]]
        for _ in zip(
            range(2),
            turns(player, self.network, parameters, int(self.seeds[0])),
            strict=False,
        ):
            pass

    def check_again(self, player: Simulator, trial: int, when: str) -> None:
        """Play a trial once more and compare the outcome."""
        if self.play(player, trial) == self.expected[trial]:
            return
        text = f": seed {self.seeds[trial]} played again, {when}, has another outcome"
        raise BrokenRule(f"{text}: {self._why(trial)}")

    def _why(self, trial: int) -> str:
        """Explain why a trial has another outcome."""
        first, again, later = (self._alone(trial, state) for state in (1, 1, 2))
        used = (
            f"; it uses {' and '.join(sorted(self.world.used))}"
            if self.world.used
            else ""
        )
        if first != again:
            return (
                "new simulators differ, too; it depends on something outside, "
                f"such as variables of its class or module{used}"
            )
        if first != later:
            advice = "draw from zswarm.kernels.random.Stream(seed)"
            return f"it depends on the state of the world outside{used}; {advice}"
        return "it depends on earlier trials: initialize everything in reset"

    def _alone(self, trial: int, state: int) -> bytes:
        player = self.new()
        with self.world.in_state(state):
            return self.play(player, trial)

    # ---- the compiled form

    def check_compiled(self, simulator: CompiledSimulator) -> None:
        """Compare the compiled form with the turns."""
        one_by_one = copy.copy(self.network)
        one_by_one.step_lanes = None
        scalar = self._evaluated(simulator, one_by_one, "play", 1)
        for seed, compiled, in_turns in zip(
            self.seeds, scalar, self.expected, strict=True
        ):
            numbers = (
                f"{np.frombuffer(in_turns)} in turns, {np.frombuffer(compiled)} compiled"
            )
            text = f": the turns and the compiled form differ, seed {seed}: fitness and metrics "
            require(compiled == in_turns, text + numbers)
        if type(simulator).play_lanes is CompiledSimulator.play_lanes:
            return
        lanes = self._evaluated(simulator, self.network, "play_lanes", LANES)
        for seed, parallel, compiled in zip(self.seeds, lanes, scalar, strict=True):
            text = f".play_lanes: seed {seed} has another outcome than in play"
            require(parallel == compiled, text)

    def _evaluated(
        self,
        simulator: CompiledSimulator,
        network: Representation,
        method: str,
        width: int,
    ) -> list[bytes]:
        """Return the outcomes of a batch, checked against those of single trials.

        Args:
            width: trials that may run in parallel.
        """

        def play(begin: int, end: int, progress: np.ndarray | None = None) -> list[bytes]:
            part = slice(begin, end)
            # Before a simulator resets it.
            stopped = progress is not None and bool(progress[1])
            found = evaluate(
                simulator,
                network,
                self.genomes,
                self.participants[part],
                self.seeds[part],
                progress,
            )
            if stopped:
                text = (
                    f".{method} must end before the next trial when progress[1] is not 0"
                )
                require(np.isnan(found.fitness).all(), text)
            rows = zip(found.fitness, found.metrics, strict=True)
            return [fitness.tobytes() + metrics.tobytes() for fitness, metrics in rows]

        count, progress = len(self.seeds), np.zeros(2, np.int64)
        outcomes = play(0, count, progress)
        text = (
            f".{method}: progress[0] must be the index of the first of the trials that run, "
            f"{count - 1} in the last, or up to {width - 1} less, not {progress[0]}"
        )
        require(count - width <= progress[0] < count, text)
        for trial, seed in enumerate(self.seeds):
            text = (
                f".{method}: seed {seed} alone has another outcome than as trial {trial}"
            )
            require(play(trial, trial + 1) == [outcomes[trial]], text)
        play(0, count, np.array([0, 1]))
        return outcomes


class _World:
    """Clocks and generators, on which a simulator must not depend.

    Attributes:
        used: names of those that were used.
    """

    def __init__(self) -> None:
        self.used: set[str] = set()

    @contextlib.contextmanager
    def in_state(self, state: int) -> Iterator[None]:
        """Put clocks and generators into a state that depends on a number."""
        generators = random.getstate(), np.random.get_state()
        random.seed(state)
        np.random.seed(state)
        seeded = random.getstate(), str(np.random.get_state())
        later_s = state * LATER_S
        clocks = {
            name: self._later(name, later_s * per_s) for name, per_s in CLOCKS.items()
        }
        try:
            with mock.patch.multiple(time, **clocks):
                yield
        finally:
            if random.getstate() != seeded[0]:
                self.used.add("the generator of random")
            if str(np.random.get_state()) != seeded[1]:
                self.used.add("the generator of numpy.random")
            random.setstate(generators[0])
            np.random.set_state(generators[1])

    def _later(self, name: str, later: float) -> Any:
        clock = getattr(time, name)

        def read() -> float:
            if not _compiles(sys._getframe(1)):
                self.used.add(f"time.{name}")
            now: float = clock()
            return now + type(now)(later)

        return read


def _compiles(frame: FrameType | None) -> bool:
    """Return whether the compiler is loaded or at work, which reads clocks for itself."""
    while frame is not None:
        caller = str(frame.f_globals.get("__name__"))
        if caller.partition(".")[0] == "numba" or caller == "zswarm.kernels.compiler":
            return True
        frame = frame.f_back
    return False


def _check_leaks(play: Callable[[], object]) -> None:
    """Play a trial repeatedly. What is new after each one, and stays, leaks; a cache stops."""
    new: list[dict[str, set[Any]]] = []  # for each trial
    sizes: list[int] = []  # bytes in use after each trial
    tracing = tracemalloc.is_tracing()
    tracemalloc.start()
    gc.freeze()  # otherwise each collection would take the time of many trials
    try:
        play()  # the first trials may fill caches
        play()
        before = _holds()
        for number in range(1, MOST + 1):
            play()
            gc.collect()
            sizes.append(_traced())
            now = _holds()
            new.append({name: found - before[name] for name, found in now.items()})
            leaks = {  # of each trial, at least
                name: min(len(found[name] & now[name]) for found in new) for name in now
            }
            # The mean of the later half: other threads allocate and free, too.
            half = number // 2
            grown = (sizes[-1] - sizes[half - 1]) // max(1, number - half) if half else 0
            leaks["bytes"] = max(0, grown) // LEAK_BYTES * LEAK_BYTES
            before = now
            if number >= LEAST and not any(leaks.values()):
                return
    finally:
        gc.unfreeze()
        if not tracing:
            tracemalloc.stop()
    name, count = next(item for item in leaks.items() if item[1])
    text = "close or end what it opens, starts or stores, or use it for all trials"
    raise BrokenRule(f": each trial leaks {count:,} {name}; {text}")


def _traced() -> int:
    """Return the bytes of memory that are in use."""
    return tracemalloc.get_traced_memory()[0]


def _holds() -> dict[str, set[Any]]:
    """Return the numbers of threads, open files and child processes of this process.

    By their numbers, one that ends hides no new one.
    """
    process = psutil.Process()
    return {
        "threads": {thread.id for thread in process.threads()},
        "open files": set(process_state().files),
        "processes": {child.pid for child in process.children()},
    }


@contextlib.contextmanager
def _leaving_nothing() -> Iterator[None]:
    """Compare what this process has, but for files and threads, which may be for all trials."""
    shared: set[str] = set()

    def on_shared_memory(name: str, exists: bool) -> None:
        (shared.add if exists else shared.discard)(name)

    before = process_state()
    stop = shared_memory.watch(on_shared_memory)
    try:
        yield
    finally:
        stop()
    now = process_state()
    # The compiler, which networks load when they are first used, sets variables of its own.
    numba = {name: each for name, each in now.environment.items() if b"NUMBA" in name}
    before.environment.update(numba)
    left = left_behind(before._replace(files=now.files, threads=sys.maxsize))
    left += [f"shared memory ({name})" for name in sorted(shared)]
    text = (
        "restore or remove it at the end of the trial, or do it once in the constructor"
    )
    require(not left, f": trials leave in their process: {'; '.join(left)}; {text}")
