"""Measure the processor time of an optimizer's dispatch for an event, by the number of servers.

Servers of 4 slots are simulated; no messages are sent. It measures how an event is handled: a
server that joins while trials wait (three events), an answer to a batch with and without
``verify``, a renewal with its answer, and the passing of time; not what zenoh takes besides.
"""

import argparse
import gc
import itertools
import json
import statistics
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import machine
import numpy as np
import tables

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


def _each_us(event: Callable[[], None]) -> float:
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
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--quick", action="store_true", help="whether it works")
    parser.add_argument(
        "--folder", type=Path, help="where the results go [default: build/bench]"
    )
    options = parser.parse_args()
    rows = [measure(servers) for servers in SERVERS[: 1 if options.quick else None]]
    file = machine.write("many_servers", rows, folder=options.folder)
    print(f"{tables.many_servers(json.loads(file.read_text()))}\n{file}")


if __name__ == "__main__":
    main()
