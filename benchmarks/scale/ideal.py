"""Compute the shortest possible generation: same trials and servers, no network."""

import heapq
import itertools
from collections import deque
from typing import Any, NamedTuple

from scale.pretended import CAPACITY, Times, draws, durations, salt, speed
from zswarm.ot.cluster.schedule import DEPTH
from zswarm.ot.workload import Workload


class Schedule(NamedTuple):
    """Seconds of a generation on the same servers, without any network or computing."""

    bound: float  # as dispatch does: what waits at a server stays there
    free: float  # every slot takes the next trial that nobody started
    # When none is left, one that another slot would finish later: by an oracle.
    twice: float


def schedule(times: Times, workload: Workload, servers: int) -> Schedule:
    """Play a generation by list scheduling."""
    by_server = [
        durations(
            times,
            draws(
                workload.genomes,
                workload.participants,
                workload.seeds,
                salt(times, server),
            ),
        )
        / speed(times, server)
        for server in (range(servers) if times.of == "execution" else (0, 1))
    ]
    last = len(by_server) - 1

    def takes(trial: int, server: int) -> float:
        return float(by_server[min(server, last)][trial])

    count = len(workload.seeds)
    return Schedule(_bound(count, servers, takes), *_free(count, servers, takes))


def _bound(count: int, servers: int, takes: Any) -> float:
    order = iter(range(count))
    waiting: list[deque[int]] = [deque() for _ in range(servers)]
    for _ in range(DEPTH):
        for server in range(servers):
            waiting[server].extend(itertools.islice(order, CAPACITY))
    slots_free = [(0.0, slot) for slot in range(servers * CAPACITY)]
    end = 0.0
    while slots_free:
        now, slot = heapq.heappop(slots_free)
        server = slot // CAPACITY
        if now:  # it has just finished one, so the server gets another
            waiting[server].extend(itertools.islice(order, 1))
        end = max(end, now)
        if waiting[server]:
            heapq.heappush(
                slots_free, (now + takes(waiting[server].popleft(), server), slot)
            )
    return end


def _free(count: int, servers: int, takes: Any) -> tuple[float, float]:
    free = [(0.0, slot) for slot in range(servers * CAPACITY)]
    ends, slots_of = {}, {}
    for trial in range(count):
        now, slot = heapq.heappop(free)
        ends[trial], slots_of[trial] = now + takes(trial, slot // CAPACITY), [slot]
        heapq.heappush(free, (ends[trial], slot))
    plain = max(ends.values())
    while free:
        now, slot = heapq.heappop(free)
        sooner = [
            trial
            for trial, end in ends.items()
            if end > now and now + takes(trial, slot // CAPACITY) < end
        ]
        ends = {trial: end for trial, end in ends.items() if end >= now}
        if sooner:  # if not, nor later
            late = max(sooner, key=ends.__getitem__)
            ends[late] = now + takes(late, slot // CAPACITY)
            # They give it up then.
            free = [(time, slot) for time, slot in free if slot not in slots_of[late]]
            slots_of[late].append(slot)
            free += [(ends[late], slot) for slot in slots_of[late]]
            heapq.heapify(free)
    return plain, now
