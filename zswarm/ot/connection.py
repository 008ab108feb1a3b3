"""The servers that somebody uses: this machine's slots, which start first and load meanwhile, and how to reach the others."""

import atexit
import contextlib
import functools
import operator
import threading
from collections.abc import Iterator, Sequence
from types import TracebackType
from typing import TYPE_CHECKING, Any, NamedTuple, Self

from zswarm.experiment import Cluster, slots_of_this_machine
from zswarm.ot.local import LocalServer

if TYPE_CHECKING:
    import numpy as np

    from zswarm.ot.evaluations import Evaluations
    from zswarm.ot.leases import Leases
    from zswarm.ot.problem import Problem
    from zswarm.ot.workload import Workload
    from zswarm.session import Reach


class Outcomes(NamedTuple):
    """What candidates did, trial by trial."""

    fitness: "np.ndarray"  # (candidates, trials) float64; NaN: the simulator failed
    metrics: dict[str, "np.ndarray"]  # each (candidates, trials) float64


class Connection:
    """Servers for any number of runs and evaluations, from entering to leaving.

    Attributes:
        options: which servers.
        local: this machine's slots; None where none are asked for.
        runs: the threads of the runs that hold slots now.
        using: the leases that are there now.
        closed: for good: what goes on ends within a moment.
    """

    hinted = False  # the user was told that nobody is found

    def __init__(self, options: Cluster) -> None:
        self.options = options
        self.local: LocalServer | None = None
        self.runs: list[int] = []
        self.using: set[Evaluations] = set()
        self._leases: Leases | None = None
        self.closed = False
        self._lock = threading.Lock()  # opening and closing, by any thread

    def __repr__(self) -> str:
        who = self.who_computes().removeprefix("waiting for ").removeprefix(", and ")
        return f"<zswarm.Connection: {'closed' if self.closed else who or 'not open'}>"

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def open(self) -> None:
        """Start this machine's slots, if they are asked for and not started yet.

        Raises:
            RuntimeError: it was closed.
        """
        with self._lock:
            self._refuse_closed()
            if self.local is None and not isinstance(self.options.servers, int):
                self.local = LocalServer(slots_of_this_machine(self.options), self.options.realm)
                atexit.register(self.close)  # a program may end without closing it

    def close(self) -> None:
        """End what goes on, runs too, and this machine's slots; a second time nothing."""
        with self._lock:
            self.closed = True
        atexit.unregister(self.close)
        if self._leases is not None:
            self._leases.close()
        if self.local is not None:
            local, self.local = self.local, None
            local.__exit__(None, None, None)

    def evaluate(
        self, problem: "Problem", candidates: "Sequence[bytes] | np.ndarray | Sequence[Any]", *, generation: int = 0
    ) -> "np.ndarray":
        """Fitness of candidates, for any optimizer that asks and tells; several threads may call.

        Of a problem that several participants play, candidates play each other as its ranking has it, and what comes back is
        their scores, which compare within this call only.

        What servers there are share the trials. Their slots stay this program's for some seconds after the last call.

        Args:
            problem: what judges them (``zswarm.problem``).
            candidates: genomes, or (n, problem.genes) numbers.
            generation: decides the trials' seeds where the problem wants fresh ones in each.

        Returns:
            (n,) float64, higher is better: the sum over the problem's trials, or the score; NaN where the simulator failed.

        Raises:
            ValueError: candidates or a generation that do not fit the problem.
            TypeError: no problem, no candidates.
            ConfigError: too few candidates for a game.
            EvaluationError: trials cannot be evaluated: a fault of machines or programs.
            NoServers: the number of servers asked for was not there in time.
            RuntimeError: a run of this thread holds the slots, or the connection is closed.

        Example::

            with zswarm.connect() as cluster:
                fitness = cluster.evaluate(problem, problem.random(50))
        """
        from zswarm.ot.assessment import Assessment

        assessment = Assessment(problem, self._genomes(problem, candidates, generation), generation)
        self._play(problem, assessment.workload)
        while assessment.advance():
            self._play(problem, assessment.workload)
        return assessment.fitness()

    def outcomes(
        self,
        problem: "Problem",
        candidates: "Sequence[bytes] | np.ndarray | Sequence[Any]",
        *,
        generation: int = 0,
        seeds: Sequence[int] | None = None,
    ) -> Outcomes:
        """What candidates did in each trial, the simulator's metrics too; otherwise as ``evaluate``.

        Args:
            seeds: of the trials, whole numbers from 0 to 2^64 - 1, instead of the problem's own; such as unseen ones.

        Raises:
            ValueError: several participants play the problem: no candidate has trials of its own.
        """
        import numpy as np

        genomes = self._genomes(problem, candidates, generation)
        if problem.simulator.participants > 1:
            raise ValueError(
                f"problem: {problem.experiment.problem.simulator} is a game of {problem.simulator.participants}: no candidate "
                "has trials of its own; evaluate has candidates play each other"
            )
        chosen = None if seeds is None else np.array(_checked_seeds(seeds), np.uint64)
        workload = problem.workload(genomes, generation, chosen)
        self._play(problem, workload)
        shape = (len(workload.genomes), -1) if workload.genomes else (0, problem.experiment.problem.trials)
        names = problem.simulator.metrics
        return Outcomes(
            workload.fitness.reshape(shape),
            {name: workload.metrics[:, column].reshape(shape) for column, name in enumerate(names)},
        )

    @contextlib.contextmanager
    def run(self) -> Iterator[None]:
        """While a run of this thread holds slots.

        Raises:
            RuntimeError: it would wait for ever for another one of this thread, or the connection is closed.
        """
        self._refuse_waiting_for_itself()
        self.open()
        thread = threading.get_ident()
        self.runs.append(thread)
        try:
            if self._leases is not None:
                self._leases.release()
            yield
        finally:
            self.runs.remove(thread)

    @property
    def slots(self) -> int:
        """Slots that are ready, of all leases together."""
        return sum(evaluations.slots for evaluations in list(self.using))

    @functools.cached_property
    def reach(self) -> "Reach":
        """How other machines are reached, with the keys that are installed.

        Raises:
            ConfigError: the keys cannot be used.
        """
        from zswarm.security import keyring
        from zswarm.session import Reach

        if self.options.servers == "local":
            return Reach((), multicast=False)
        return Reach(self.options.connect, self.options.multicast, self.options.through_router, keyring.installed("ot"))

    def who_computes(self) -> str:
        """For people."""
        servers, realm = self.options.servers, self.options.realm
        here = f"{self.local.slots} slot{'s' if self.local.slots != 1 else ''} of this machine" if self.local else ""
        if servers == "local":
            return here
        if servers == "auto":
            return f"{here}, and every server found in realm {realm}"
        return f"waiting for {servers} servers in realm {realm}"

    def _genomes(self, problem: "Problem", candidates: Any, generation: int) -> list[bytes]:
        from zswarm.ot.problem import Problem, check_whole

        if not isinstance(problem, Problem):
            raise TypeError(
                f"problem: expected what zswarm.problem gives, before the candidates, not an object of {type(problem).__name__}"
            )
        check_whole("generation", generation)
        return problem.genomes(candidates)

    def _play(self, problem: "Problem", workload: "Workload") -> None:
        """Have it counted."""
        from zswarm.ot.leases import Leases

        self._refuse_waiting_for_itself()
        self.open()
        with self._lock:
            self._refuse_closed()
            if self._leases is None:
                self._leases = Leases(self)
        self._leases.evaluate(problem, workload)

    def _refuse_closed(self) -> None:
        if self.closed:
            raise RuntimeError("this connection is closed: connect again")

    def _refuse_waiting_for_itself(self) -> None:
        if threading.get_ident() in self.runs:
            raise RuntimeError(
                "a run that this thread began holds the slots of this connection: leave its block first, "
                "or use another connection, such as zswarm.connect('local')"
            )


def _checked_seeds(seeds: Any) -> list[int]:
    expected = "seeds: expected a list of whole numbers, one at least, each from 0 to 2^64 - 1"
    try:
        numbers = [operator.index(seed) for seed in seeds]
    except TypeError:
        raise TypeError(f"{expected}, not {seeds!r:.60}") from None
    if not numbers or min(numbers) < 0 or max(numbers) >= 2**64:
        raise ValueError(f"{expected}, not {seeds!r:.60}")
    return numbers
