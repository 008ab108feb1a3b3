"""The servers that a user's runs and evaluations share; each of these has its own ``Cluster``.

This machine's slots start first, and load while this program does; so heavy modules are imported
when they are needed.
"""

import atexit
import contextlib
import functools
import getpass
import secrets
import threading
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, Self

from msgspec import structs

from zswarm.config.sections import ClusterConfig
from zswarm.errors import Stopped
from zswarm.experiment import slots_of_this_machine
from zswarm.ot.cluster.local import LocalServer
from zswarm.protocol import keys
from zswarm.protocol.keys import RunKey
from zswarm.system.format import plural

if TYPE_CHECKING:
    import numpy as np

    from zswarm.ot.cluster.machines import Known
    from zswarm.ot.cluster.matching import RunProgram
    from zswarm.ot.cluster.shell import Cluster, Item
    from zswarm.ot.evaluator import CandidateEvaluator, CandidateOutcomes
    from zswarm.ot.problem import Problem
    from zswarm.session import Reach


WAIT_FOR_SERVERS_S = 10.0  # for the number of servers that is asked for


class Connection:
    """Servers for any number of runs and evaluations, from entering to leaving.

    Attributes:
        options: which servers.
        local: this machine's slots; None where none are asked for.
        run_threads: ids of the threads whose runs hold slots now.
        clusters: those that hold leases now.
        closed: for good; what still runs ends within a moment.
        banned: machines that computed wrong for one of its clusters, and as which server.
    """

    def __init__(self, options: ClusterConfig) -> None:
        self.options = options
        self.local: LocalServer | None = None
        self.run_threads: list[int] = []
        self.clusters: set[Cluster] = set()
        self.closed = False
        self.banned: dict[str, str] = {}
        self._hinted = threading.Event()  # the user knows that no server is found
        self._evaluator: CandidateEvaluator | None = None
        self._lock = threading.Lock()  # opening and closing, by any thread

    def __repr__(self) -> str:
        who = self.who_computes().removeprefix("waiting for ").removeprefix(", and ")
        return f"<zswarm.Connection: {'closed' if self.closed else who or 'not open'}>"

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    def open(self) -> None:
        """Start this machine's slots, if they are asked for and not started yet."""
        with self._lock:
            self._refuse_closed()
            if self.local is None and not isinstance(self.options.servers, int):
                self.local = LocalServer(
                    slots_of_this_machine(self.options), self.options.realm
                )
                atexit.register(self.close)  # a program may end without closing it

    def close(self) -> None:
        """End runs, evaluations and this machine's slots; do nothing if called again."""
        with self._lock:
            self.closed = True
        atexit.unregister(self.close)
        if self._evaluator is not None:
            self._evaluator.close()
        if self.local is not None:
            local, self.local = self.local, None
            local.close()

    def evaluate(
        self,
        problem: "Problem",
        candidates: "Sequence[bytes] | np.ndarray | Sequence[Any]",
        *,
        generation: int = 0,
    ) -> "np.ndarray":
        """Evaluate candidates, for any optimizer that asks and tells; several threads may call.

        All servers share the trials; their slots stay this program's for some seconds. In a
        problem for several participants, candidates play each other, and the result is their
        scores, which compare within this call only.

        Args:
            problem: as ``zswarm.problem`` returns it.
            candidates: genomes, or (n, problem.genes) numbers.
            generation: decides the trials' seeds if they are fresh in each generation.

        Returns:
            (n,) float64, higher is better: the sum over the problem's trials, or the score; NaN
            where the simulator failed.

        Raises:
            ValueError: candidates or a generation that do not fit the problem.
            TypeError: arguments that are not a problem, or not candidates.
            ConfigError: too few candidates for a game.
            EvaluationError: machines or programs failed.
            NoServers: too few servers were found in time.
            RuntimeError: a run of this thread holds the slots, or the connection is closed.

        Example::

            with zswarm.connect() as cluster:
                fitness = cluster.evaluate(problem, problem.random(50))
        """
        return self._evaluates().evaluate(problem, candidates, generation)

    def outcomes(
        self,
        problem: "Problem",
        candidates: "Sequence[bytes] | np.ndarray | Sequence[Any]",
        *,
        generation: int = 0,
        seeds: Sequence[int] | None = None,
    ) -> "CandidateOutcomes":
        """Return what candidates did in each trial, with metrics; otherwise like ``evaluate``.

        Args:
            seeds: of the trials, 0 to 2^64 - 1, instead of the problem's own.

        Raises:
            ValueError: the problem is a game: no candidate has trials of its own.
        """
        return self._evaluates().outcomes(problem, candidates, generation, seeds)

    @contextlib.contextmanager
    def run(self) -> Iterator[None]:
        """Hold slots for a run of this thread; RuntimeError if another of its runs does."""
        self._refuse_waiting_for_itself()
        self.open()
        thread = threading.get_ident()
        self.run_threads.append(thread)
        try:
            if self._evaluator is not None:
                self._evaluator.release()
            yield
        finally:
            self.run_threads.remove(thread)

    @contextlib.contextmanager
    def cluster(
        self,
        problem: "Problem",
        *,
        run: str,
        slots: int,
        say: Callable[[str], None],
        wait: Callable[[str], None],
        stop: threading.Event,
        program: "RunProgram | None" = None,
        probe: bytes = b"",
        taken_over: Callable[[], bool] = lambda: False,
        known: "Known | None" = None,
    ) -> "Iterator[Cluster]":
        """Hold leases of all servers that match a problem, within a ``with`` block.

        Args:
            run, program: how servers know the holder of the leases.
            slots: wanted at most, on every server.
            say, wait: take lines for the user, ``wait`` those about what is waited for.
            stop: ends an evaluation when it is set.
            probe: digest of the probe's outcomes, if it is known.
            taken_over: returns whether another program resumed the run, as its record shows.
            known: what earlier programs of the run found out about machines.
        """
        from zswarm.ot.cluster.machines import Known
        from zswarm.ot.cluster.matching import RunProgram, terms
        from zswarm.ot.cluster.remote_controllers import RemoteControllers
        from zswarm.ot.cluster.shell import Cluster
        from zswarm.ot.cluster.watch import Watch
        from zswarm.ot.evaluator import arbitrate

        options, reach, local = self.options, self.reach, self.local
        experiment, simulator = problem.experiment, problem.simulator
        program = program or RunProgram(0, secrets.token_bytes(16))
        known = known or Known()
        known = structs.replace(known, banned={**self.banned, **known.banned})
        run_of: Any = {"slots": slots, "probe": probe, "known": known}
        asked = terms(experiment, options, simulator, program, **run_of)
        hosted = problem.representation, simulator.participants
        controllers = RemoteControllers(*hosted) if asked.reserve.asks else None
        name, check = experiment.problem.simulator, functools.partial(self._check, stop)
        watch = Watch(options, name, local, self._hinted, say, wait, check)
        cluster = Cluster(
            RunKey(options.realm, self._user(), run),
            asked,
            reach=reach,
            arbitrate=functools.partial(arbitrate, problem),
            taken_over=taken_over,
            local=local.endpoint if local is not None else "",
            controllers=controllers,
            watch=watch,
        )
        with cluster:
            self.clusters.add(cluster)
            try:
                yield cluster
            finally:
                self.clusters.discard(cluster)
                self.banned.update(cluster.banned())

    def _user(self) -> str:
        """Return who owns the runs."""
        ring = self.reach.keyring
        return ring.name if ring is not None else keys.fold(getpass.getuser())

    def _check(self, stop: threading.Event) -> None:
        """Raise Stopped if a run is to end."""
        if stop.is_set():
            raise Stopped("stopped")
        if self.closed:
            raise Stopped("the connection was closed")

    def wait(self, cluster: "Cluster") -> "Iterator[Item | None]":
        """Wait for the number of servers that is asked for; see ``Cluster.wait``."""
        servers = self.options.servers
        return (
            cluster.wait(servers, WAIT_FOR_SERVERS_S)
            if isinstance(servers, int)
            else iter(())
        )

    @property
    def slots(self) -> int:
        """Slots that are ready, of all leases together."""
        return sum(cluster.standing.slots for cluster in list(self.clusters))

    @functools.cached_property
    def reach(self) -> "Reach":
        """Return how other machines are reached; ConfigError if installed keys cannot be used."""
        from zswarm.security import keyring
        from zswarm.session import Reach

        options = self.options
        if options.servers == "local":
            return Reach((), multicast=False)
        ring = keyring.installed("ot")
        return Reach(options.connect, options.multicast, options.through_router, ring)

    def who_computes(self) -> str:
        """Return who evaluates, for the user."""
        servers, realm = self.options.servers, self.options.realm
        slots = self.local.slots if self.local else 0
        here = f"{plural(slots, 'slot')} of this machine" if self.local else ""
        if servers == "local":
            return here
        if servers == "auto":
            return f"{here}, and every server found in realm {realm}"
        return f"waiting for {plural(servers, 'server')} in realm {realm}"

    def _evaluates(self) -> "CandidateEvaluator":
        from zswarm.ot.evaluator import CandidateEvaluator

        self._refuse_waiting_for_itself()
        self.open()
        with self._lock:
            self._refuse_closed()
            if self._evaluator is None:
                self._evaluator = CandidateEvaluator(
                    self.cluster, self.wait, lambda: bool(self.run_threads)
                )
        return self._evaluator

    def _refuse_closed(self) -> None:
        if self.closed:
            raise RuntimeError("this connection is closed: connect again")

    def _refuse_waiting_for_itself(self) -> None:
        if threading.get_ident() in self.run_threads:
            raise RuntimeError(
                "a run that this thread began holds the slots of this connection: leave its block"
                " first, or use another connection, such as zswarm.connect('local')"
            )
