"""Workloads of one problem on the servers of a connection: disputes are settled by this machine, and whoever follows is told."""

import getpass
import secrets
import threading
import time
from collections.abc import Iterator
from types import TracebackType
from typing import Self

import numpy as np

from zswarm import evaluate
from zswarm.errors import EvaluationError, Stopped
from zswarm.ot import matching
from zswarm.ot.cluster import Cluster, Item
from zswarm.ot.connection import Connection
from zswarm.ot.controllers import Controllers
from zswarm.ot.dispatch import Counted, Disputed, Note, ProbeDisputed, ProbeSettled, Retracted, Settled
from zswarm.ot.logger import Logger
from zswarm.ot.problem import Problem
from zswarm.ot.requests import Wanted, Who
from zswarm.ot.workload import Workload
from zswarm.protocol import keys, messages
from zswarm.session import Reach

WAIT_FOR_SERVERS_S = 10.0  # for the number of servers asked for
PREPARING_S = 1.0  # of a server, before the user is told
PAUSE_S = 3.0  # without any server, before the user is told
HINT = "zswarm-ot doctor says why, docs/network.md what to do"
NOBODY_YET = "no slot is ready yet: waiting for one (Ctrl-C stops; nothing is lost)"
NOBODY = "no server computes now: waiting for one (Ctrl-C stops; nothing is lost)"

Happened = Counted | Retracted | Note
TOLD = {
    "diagnosis": "{text}",
    "server_joined": "{server} joined with {slots}",
    "server_left": "{server} left; {text}",
    "server_lost": "{server} is gone",
    "server_back": "{server} is back",
    "server_mismatch": "{server} is not used: {text}",
    "server_refused": "{server} refused: {text}",
    "server_differs": "{server} is not used: {text}",
    "server_faulty": "{server} is put aside for ten minutes: {text}",
    "server_wrong": "{server} is used no more: {text}; what it did in this generation, or round of games, is "
    "evaluated again, and marked as doubtful in earlier ones",
    "unverified": "trials are counted unverified: {text}",
    "server_silent": "{server} does not answer ({text}); it is asked again in a while",
    "lease_lost": "{server}: {text}; reserving anew",
    "lease_waiting": "{server} is busy for others: waiting for a slot",
    "fault": "{server}: {text}",
    "malformed": "{server} sent something that is no answer: {text}",
    "simulator_raised": "the simulator failed on {server}: {text} ({count} trials)",
}


class Evaluations:
    """A problem's leases, from entering to leaving.

    Args:
        connection: the servers.
        run, epoch: what the servers know the holder of the leases by.
        slots: wanted at most.
        probe: digest of the probe's outcomes, if it is known from before.
        logger: is told.
        stop: ends what goes on when it is set.
    """

    def __init__(
        self,
        problem: Problem,
        connection: Connection,
        *,
        run: str,
        epoch: int,
        slots: int,
        probe: bytes,
        logger: Logger,
        stop: threading.Event,
    ) -> None:
        self._problem, self._connection, self._logger, self._stop = problem, connection, logger, stop
        options, reach = connection.options, connection.reach
        simulator, representation = problem.experiment.problem, problem.experiment.representation
        wanted = Wanted(
            requirements=matching.requirements(problem.experiment, options),
            choice=matching.choice(options),
            simulator=messages.Part(simulator.simulator, simulator.settings),
            representation=messages.Part(representation.kind, representation.settings),
            participants=problem.simulator.participants,
            metrics=len(problem.simulator.metrics),
            trial_timeout_s=options.trial_timeout_s,
            trial_memory_mb=options.trial_memory_mb,
            slots=min(slots, messages.MAX_SLOTS),
            quarantine=options.on_fault == "quarantine",
            verify=options.verify,
            probe=probe,
            asks=options.messages if options.controller == "optimizer" else "",
        )
        who = Who(options.realm, _user(reach), run, epoch, secrets.token_bytes(16))
        self._met, self._begun = False, time.monotonic()  # whether a server of the network was seen
        local = connection.local
        self._cluster = Cluster(
            who,
            wanted,
            reach=reach,
            local=local.endpoint if local is not None else "",
            controllers=Controllers(problem.representation, problem.simulator.participants) if wanted.asks else None,
        )

    def __enter__(self) -> Self:
        self._cluster.__enter__()
        self._connection.using.add(self)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._connection.using.discard(self)
        self._cluster.__exit__(kind, error, trace)

    @property
    def servers(self) -> int:
        """Servers with a slot ready."""
        return len(self._cluster.standing.serving)

    @property
    def slots(self) -> int:
        """Slots that are ready."""
        return self._cluster.standing.slots

    @property
    def probe(self) -> bytes:
        """Digest of the probe's outcomes, once known."""
        return self._cluster.standing.probe

    def wait(self) -> Iterator[Happened | None]:
        """Wait for the number of servers asked for, if one was; yields as ``evaluate`` does.

        Raises:
            NoServers: not in time.
            Stopped: ``stop`` was set, or the connection was closed.
        """
        if isinstance(self._connection.options.servers, int):
            for item in self._cluster.wait(self._connection.options.servers, WAIT_FOR_SERVERS_S):
                self._look_whether_to_stop()
                self._hint()
                yield from self._taken(item)

    def evaluate(self, workload: Workload) -> Iterator[Happened | None]:
        """Have evaluated what is not counted yet, from now on; yields what happens, and None when nothing does for 0.1 s.

        Raises:
            EvaluationError: trials cannot be evaluated.
            Stopped: ``stop`` was set, or the connection was closed.
        """
        return self._follow(workload, self._cluster.evaluate(workload))

    def _follow(self, workload: Workload, items: Iterator[Item | None]) -> Iterator[Happened | None]:
        last_served, told, served = time.monotonic(), "", False
        for item in items:
            self._look_whether_to_stop()
            yield from self._taken(item, workload)
            self._hint()
            idle = time.monotonic() - last_served
            local = self._connection.local
            if self._cluster.standing.serving:
                last_served, told, served = time.monotonic(), "", True
            elif local is not None and (words := local.ended()):
                raise EvaluationError(f"the slots of this machine ended: {words}")
            elif (preparing := self._cluster.standing.preparing) and idle > PREPARING_S and not told:
                simulator = self._problem.experiment.problem.simulator
                told = f"{', '.join(preparing)}: getting {simulator} ready; it is compiled once for each version of zswarm"
                self._logger.on_say(told)
            elif not preparing and idle > PAUSE_S and told not in (NOBODY, NOBODY_YET):  # one that got ready may be gone
                told = NOBODY if served or local is None else NOBODY_YET
                self._logger.on_say(told)
                if local is None:
                    self._cluster.diagnose()

    def rest(self) -> Iterator[Happened | None]:
        """What happened that was not yielded yet."""
        for item in self._cluster.rest():
            yield from self._taken(item)

    def _look_whether_to_stop(self) -> None:
        if self._stop.is_set():
            raise Stopped("stopped")
        if self._connection.closed:
            raise Stopped("the connection was closed")

    def _taken(self, item: Item | None, workload: Workload | None = None) -> Iterator[Happened | None]:
        """Do what something that happened asks for; disputes are of the workload."""
        simulator, representation = self._problem.simulator, self._problem.representation
        match item:
            case Disputed() if workload is not None:
                outcomes = evaluate.evaluate(simulator, representation, *workload.batch(np.array([item.trial])))
                self._cluster.settle(Settled(item.trial, outcomes.fitness[0], outcomes.metrics[0]))
            case ProbeDisputed():
                self._cluster.settle(ProbeSettled(evaluate.probe(simulator, representation).digest))
            case Note():
                yield item
                self._tell(item)
            case Counted() if workload is None:
                pass  # of a workload that is over
            case Counted() | Retracted() | None:
                yield item

    def _hint(self) -> None:
        """Once, where other machines are asked for and none was seen for a while."""
        options = self._connection.options
        if self._met or self._connection.hinted or options.servers == "local" or time.monotonic() < self._begun + PAUSE_S:
            return
        self._connection.hinted = True
        alone = ": this machine's slots compute alone" if self._connection.local is not None else ""
        self._logger.on_say(f"no server found in realm {options.realm}{alone}; {HINT}")

    def _tell(self, note: Note) -> None:
        options = self._connection.options
        self._met = self._met or (bool(note.server) and not note.server.startswith("local-"))
        self._logger.on_event(note)
        if note.event in TOLD:
            slots = f"{note.count} slot{'s' if note.count != 1 else ''}"
            self._logger.on_say(TOLD[note.event].format(server=note.server, text=note.text, count=note.count, slots=slots))
        refused = note.event in ("server_refused", "server_mismatch") and note.server.startswith("local-")
        unwanted = bool(options.require) and options.servers != "local"  # others may be what is required
        if refused and not unwanted and self._connection.local is not None and not self._cluster.standing.serving:
            raise EvaluationError(note.text)


def _user(reach: Reach) -> str:
    return reach.keyring.name if reach.keyring else keys.fold(getpass.getuser())
