"""Processor time that an optimizer's dispatch takes for an event, by the number of servers.

    python benchmarks/many_servers.py [SERVERS ...]

Servers of 4 slots are simulated; no messages are sent. It measures the event's handling alone: a
server that joins while trials wait, an answer with and without ``verify``, a renewal, and the
passing of time; and prints a line of JSON for each number of servers, in microseconds. It does not
measure what the shell and zenoh take besides.
"""

import gc
import itertools
import json
import statistics
import sys
import time
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from zswarm.ot.cluster.dispatch import Dispatch
from zswarm.ot.cluster.events import Answered, Ask, Command, Event, Seen, TimePassed, Work
from zswarm.ot.cluster.matching import Terms
from zswarm.ot.cluster.servers import RENEW_S
from zswarm.ot.workload import Workload
from zswarm.protocol import messages
from zswarm.protocol.messages import Lease, Offer, Outcomes, Part, Requirements, Reserve

SERVERS = (100, 1_000, 4_000)
SLOTS = 4  # of a server
TRIALS = 20  # for each slot
MEASURED = 200  # events of each kind
PROBE = bytes(messages.PROBE_TRIALS * messages.PROBE_DIGEST)


class Run:
    """A run whose servers answer at once, or not at all."""

    def __init__(self, servers: int, verify: float) -> None:
        reserve = Reserve(
            nonce=bytes(16),
            epoch=0,
            slots=messages.MAX_SLOTS,
            simulator=Part("", {}),
            representation=Part("", {}),
            version_hash="",
            trial_timeout_s=60.0,
        )
        asked = Requirements()
        terms = Terms(requirements=asked, reserve=reserve, verify=verify, probe=PROBE)
        self.dispatch = Dispatch(terms)
        self.now = 100.0
        self.batches: list[Ask] = []
        self._names = itertools.count()
        for _ in range(servers):
            self.join()
            self.now += RENEW_S / servers  # their leases are renewed one after the other
        self.feed(Work(self._workload(servers)))

    def join(self) -> None:
        """Let a server appear, which grants all its slots."""
        self.feed(Seen(f"lab-{next(self._names)}"))

    def answer(self) -> None:
        """Answer the oldest batch."""
        ask = self.batches.pop(0)
        assert ask.trials is not None
        assert isinstance(ask.message, messages.Evaluate)
        fitness = np.zeros(len(ask.trials)).tobytes()
        seconds = float(len(ask.trials))
        reply = Outcomes(
            batch=ask.message.batch, fitness=fitness, metrics=b"", seconds=seconds
        )
        self.feed(Answered(ask.question, reply))

    def renew(self) -> None:
        """Let the next lease be renewed: the time comes, and the server answers."""
        self.now = max(self.now, self.dispatch.servers.next_time())
        self.feed(TimePassed())

    def feed(self, event: Event) -> None:
        """Give the dispatch an event, and answer all that it asks but batches."""
        commands = self.dispatch.handle(event, self.now)
        while commands:
            commands = [
                command
                for reply in self._replies(commands)
                for command in self.dispatch.handle(reply, self.now)
            ]

    def _replies(self, commands: Iterable[Command]) -> Iterator[Answered]:
        for command in commands:
            match command:
                case Ask(message=messages.Evaluate()):
                    self.batches.append(command)
                case Ask(message=Requirements()):
                    yield Answered(command.question, _offer(command.server))
                case Ask(message=Reserve() | messages.Renew()):
                    yield Answered(command.question, _lease(command.server))

    def _workload(self, servers: int) -> Workload:
        count = servers * SLOTS * TRIALS
        numbers = np.arange(count)
        return Workload(
            [b"genome"], np.zeros((count, 1), int), numbers.astype(np.uint64), 0
        )


def _offer(server: str) -> Offer:
    return Offer(
        server=server,
        program="",
        machine="",
        capacity=SLOTS,
        free=SLOTS,
        leases=0,
        simulators=[],
        representations=[],
    )


def _lease(server: str) -> Lease:
    token = server.encode().rjust(16)
    return Lease(
        lease=token, state="ready", slots=SLOTS, ready=SLOTS, probe=PROBE, trial_s=1.0
    )


def measure(servers: int) -> dict[str, Any]:
    """Return the microseconds of each kind of event."""
    alone, verified = Run(servers, 0.0), Run(servers, 0.01)
    for run in (alone, verified):
        for _ in range(20):
            run.answer()
            run.renew()
    row: dict[str, Any] = {"servers": servers}
    for name, run, event in (
        ("answer_us", alone, Run.answer),
        ("verified_answer_us", verified, Run.answer),
        ("join_us", alone, Run.join),
        ("renewal_us", alone, Run.renew),
        ("tick_us", alone, lambda run: run.feed(TimePassed())),
        ("standing_us", alone, lambda run: run.dispatch.servers.standing()),
    ):
        row[name] = round(_each_us(lambda run=run, event=event: event(run)), 1)
    return row


def _each_us(event: Any) -> float:
    gc.collect()
    gc.disable()
    times = []
    for _ in range(MEASURED):
        begin = time.thread_time_ns()
        event()
        times.append(time.thread_time_ns() - begin)
    gc.enable()
    return statistics.median(times) / 1000


def main() -> None:
    """Measure what the arguments name."""
    for servers in map(int, sys.argv[1:] or SERVERS):
        sys.stdout.write(json.dumps(measure(servers)) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
