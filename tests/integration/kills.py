"""Kill and stop busy processes again and again during one run, by a seed.

Killed processes are started again: a server on its port, an optimizer by ``resume``. The killer
makes sure that it hits a busy process: a slot, its server or its fork server only when the slot's
process is in a trial, the optimizer only when it recorded trials since its start. ``kills.jsonl``
in the scene's folder has each strike with its evidence.
"""

import json
import os
import random
import signal
import time
from typing import Any, NamedTuple

from tests.integration.paced import Pace, Scene, Size
from tests.integration.programs import (
    Optimizer,
    Server,
    children,
    query,
    status,
    wait_until,
)

SERVERS = 3  # of one slot
LOOK_S = 0.03  # between two looks for a busy process
FAST_S, SLOW_S = 0.03, 0.3  # of a trial; the second while the run is ahead of the killer
# Of a stopped server; the last is longer than the link timeout.
STOPPED_S = (0.5, 2.0, 10.0)
# What is killed, and how often, in percent.
TARGETS = {
    "slot": 45,
    "server": 20,
    "fork server": 10,
    "optimizer": 20,
    "stopped server": 5,
}


def size(kills: int) -> Size:
    """Return a run with some 50 trials per kill."""
    return Size(generations=max(3, kills // 6), population=20, trials=20)


class Strike(NamedTuple):
    """Describe a strike, which is a line of ``kills.jsonl``."""

    at_s: float  # since the campaign began
    target: str
    signal: str
    process: int
    evidence: str


class Campaign:
    """Run one experiment and kill its programs."""

    def __init__(self, scene: Scene, trials: int, kills: int, seed: int) -> None:
        """Start servers and the optimizer.

        Args:
            trials: of the whole run. They last until the last kill: trials take longer when they
                are ahead of the kills.
        """
        self.strikes: list[Strike] = []
        self.paused = 0  # times that a run stopped because one trial was hit three times
        self._scene, self._trials, self._wanted = scene, trials, kills
        self._random = random.Random(seed)
        self._begin = time.monotonic()
        self._servers: list[tuple[Server, Pace]] = [
            scene.server(f"ss-{i}") for i in range(SERVERS)
        ]
        self._go_on_at: dict[int, float] = {}  # stopped servers
        self._counted = 0
        self._start_optimizer(resume=False)

    def kills(self) -> int:
        """Return the number of SIGKILLs so far."""
        return sum(strike.signal == "SIGKILL" for strike in self.strikes)

    def run(self) -> dict[str, Any]:
        """Kill the wanted number of times, then let the run end; return its last line."""
        with (self._scene.folder / "kills.jsonl").open("w") as log:
            while self.kills() < self._wanted:
                strike = wait_until(self._strike, "somebody is busy", every_s=LOOK_S)
                self.strikes.append(strike)
                log.write(json.dumps(strike._asdict()) + "\n")
                log.flush()
        for index in list(self._go_on_at):
            self._go_on(index)
        for _, pace in self._servers:
            pace.set(0.0)
        wait_until(self._mend, "the optimizer is there")
        return self._optimizer.done()

    # ---- striking

    def _strike(self) -> Strike | None:
        """Hit the drawn target if it is busy, and restart earlier victims meanwhile."""
        self._mend()
        self._set_pace()
        target = self._random.choices(list(TARGETS), list(TARGETS.values()))[0]
        if target == "optimizer":
            return self._strike_optimizer()
        index = self._random.randrange(SERVERS)
        server, pace = self._servers[index]
        if index in self._go_on_at or not (busy := self._busy(server, pace)):
            return None
        number = signal.SIGSTOP if target == "stopped server" else signal.SIGKILL
        slot, fork_server, evidence = busy
        process = {"slot": slot, "fork server": fork_server}.get(
            target, server.process.pid
        )
        if number == signal.SIGSTOP:
            self._scene.stop(process)
            self._go_on_at[index] = time.monotonic() + self._random.choice(STOPPED_S)
        else:
            os.kill(process, number)
            if process == server.process.pid:
                server.wait()
            wait_until(
                lambda: (found := status(process)) is None or found.state == "Z",
                f"{process} has ended",
            )
        return self._struck(target, number, process, evidence)

    def _busy(self, server: Server, pace: Pace) -> tuple[int, int, str] | None:
        """Return a server's busy slot, its fork server, and the evidence."""
        fork_server = server.fork_server()
        slots = (
            children(fork_server) if fork_server and server.events("server_ready") else []
        )
        if not slots or not pace.in_trial(slots[0]):
            return None
        return slots[0], fork_server, f"slot {slots[0]}: in a trial"

    def _strike_optimizer(self) -> Strike | None:
        fresh = self._count() - self._counted_before
        if not fresh or self._optimizer.process.poll() is not None:
            return None
        self._optimizer.kill()
        self._optimizer.wait()
        return self._struck(
            "optimizer",
            signal.SIGKILL,
            self._optimizer.process.pid,
            f"recorded {fresh} trials since its start",
        )

    def _struck(self, target: str, number: int, process: int, evidence: str) -> Strike:
        return Strike(
            round(time.monotonic() - self._begin, 2),
            target,
            signal.Signals(number).name,
            process,
            evidence,
        )

    # ---- mending

    def _mend(self) -> bool:
        """Restart killed processes, continue stopped ones; return whether the optimizer runs."""
        for index in [
            index for index, time_ in self._go_on_at.items() if time_ <= time.monotonic()
        ]:
            self._go_on(index)
        for index, (server, pace) in enumerate(self._servers):
            if server.process.poll() is not None:
                port = int(server.endpoint.rpartition(":")[2])
                again = self._scene.start_server(
                    f"ss-{index}-{len(self.strikes)}", pace, port=port
                )
                self._servers[index] = (again, pace)
        if (code := self._optimizer.process.poll()) is not None:
            if code != -signal.SIGKILL:
                assert (
                    "a trial ended in a fault 3 times" in self._optimizer.err.read_text()
                ), self._optimizer.err.read_text()
                self.paused += 1
            self._start_optimizer(resume=True)
        return self._optimizer.process.poll() is None

    def _go_on(self, index: int) -> None:
        del self._go_on_at[index]
        self._scene.go_on(self._servers[index][0].process.pid)

    def _start_optimizer(self, *, resume: bool) -> None:
        up = (
            server.events("server_ready")
            for i, (server, _) in enumerate(self._servers)
            if i not in self._go_on_at
        )
        if resume and not any(up):
            return  # it would wait 10 s for a server and give up
        self._counted_before = self._count()
        endpoints = [server.endpoint for server, _ in self._servers]
        self._optimizer: Optimizer = self._scene.optimizer(
            *endpoints, resume=self._scene.run if resume else None, wait=1
        )

    def _set_pace(self) -> None:
        ahead = self._count() > 0.9 * self._trials * (self.kills() + 1) / self._wanted
        for _, pace in self._servers:
            pace.set(SLOW_S if ahead else FAST_S)

    def _count(self) -> int:
        rows = query(self._scene.run, "SELECT coalesce(sum(count), 0) FROM outcomes")
        # No rows: not readable just now.
        self._counted = max(self._counted, *(count for (count,) in rows), 0)
        return self._counted
