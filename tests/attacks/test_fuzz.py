"""Mutated messages of every kind, to a live server and a live optimizer (make fuzz SECONDS=1800).

No message ends in an error that is not typed, none ends or blocks a program, and memory stays.
"""

import os
import random
import secrets
import threading
import time
from collections import Counter
from pathlib import Path
from typing import Any

import psutil
import pytest

from tests.attacks.fake_server import FakeServers
from tests.attacks.mutation import mutated
from tests.attacks.peer import VERSION_HASH, Peer, memory_mb, reserve, serving
from tests.integration.programs import Optimizer, wait_until
from zswarm import evaluate
from zswarm.errors import RemoteProtocolError
from zswarm.protocol import codec, messages
from zswarm.protocol.messages import Evaluate, Lease, Part, Refused

pytestmark = pytest.mark.attacks

SECONDS = float(os.environ.get("FUZZ_SECONDS", "10"))
SEED = int(os.environ.get("FUZZ_SEED", "0")) or secrets.randbits(32)
MEMORY_MB = 50.0  # more than at the start, which is after a tenth of the time
LONGEST_S = 120.0
OPEN = 64  # queries at once
GENES = evaluate.build("xor", {}, "fully-meshed", {})[1].genes or 0
KEYS = (
    "zswarm/v1/default/ss/{server}/{verb}",
    "zswarm/v1/default/ss/{server}/ot/ada/{verb}",
    "zswarm/v1/default/ss/{server}/ot/ADA/run/{verb}",
    "zswarm/v1/default/ss/{server}/ot/ada/run/{verb}/more",
    "zswarm/v1/default/ss/{server}/ot/ada/run/later-{verb}",
    "zswarm/v2/default/ss/{server}/ot/ada/run/{verb}",
    "zswarm/v1/default/ss/{server}/ot/**",
    "zswarm/v1/*/ss/*/ot/ada/run-1/{verb}",
)


class ServerFuzz:
    """Send what a run sends, mutated, and check each answer."""

    def __init__(self, peer: Peer) -> None:
        self.peer, self.draw = peer, random.Random(SEED)
        self.leases: dict[str, bytes] = {}
        self.nonces = {f"run-{n}": secrets.token_bytes(16) for n in range(3)}
        self.seen: Counter[str] = Counter()
        self.wrong: list[str] = []
        self._open = threading.Semaphore(OPEN)

    def step(self) -> None:
        """Send a message, mutated most times; or a valid one to a key that is not."""
        run, draw = self.draw.choice([*self.nonces]), self.draw
        message = self._message(run)
        verb = messages.verb(message)
        body = codec.encode(message)
        if draw.random() < 0.6:
            body = mutated(message, draw)
        key = f"zswarm/v1/default/ss/{self.peer.server}/ot/fuzz/{run}/{verb}"
        if verb == "offer":
            key = f"zswarm/v1/default/ss/{self.peer.server}/offer"
        if draw.random() < 0.05:
            key = draw.choice(KEYS).format(server=self.peer.server, verb=verb)
        self._open.acquire(timeout=5.0)
        self.peer.ask_key(key, body, lambda answer: self._answered(run, verb, answer))

    def _message(self, run: str) -> messages.Request:
        draw, lease = self.draw, self.leases.get(run, bytes(16))
        match draw.choice(
            ["offer", "reserve", "renew", "cancel", "release", *["evaluate"] * 4]
        ):
            case "offer":
                return messages.Requirements(
                    simulator="xor",
                    representation="fully-meshed",
                    version_hash=VERSION_HASH,
                    settings={"a": 1, "b": [1.5, "x"]},
                    versions={"numpy": "2.3.0"},
                )
            case "reserve":
                return reserve(
                    nonce=self.nonces[run],
                    simulator=Part(
                        *draw.choice([("xor", {}), ("minisim", {"robots": 2})])
                    ),
                    slots=draw.choice([1, 2]),
                    trial_timeout_s=2.0,
                    asks="turn" if run == "run-2" else "",
                    proof=b"p" * 16,
                )
            case "renew":
                return messages.Renew(lease=lease, known_ready=draw.choice([-1, -1, 1]))
            case "cancel":
                return messages.Cancel(lease=lease, batches=[draw.randrange(300)])
            case "release" if draw.random() < 0.05:
                return messages.Release(lease=lease)
        sizes = [GENES, GENES, GENES, 0, 1, GENES - 1, GENES + 1]
        genome = draw.choice([b"\0", b"\xff"]) * (4 * draw.choice(sizes))
        trials = draw.choice([1, 3, 20])
        return Evaluate(
            lease=lease,
            batch=draw.randrange(300),
            genomes=[genome],
            participants=bytes(4 * trials),
            seeds=draw.randbytes(8 * trials),
        )

    def _answered(self, run: str, verb: str, answer: bytes | None) -> None:
        self._open.release()
        if answer is None:
            self.seen["none"] += 1
            return
        try:
            reply = codec.decode_reply(answer)
        except RemoteProtocolError as error:
            self.wrong.append(f"{verb}: {error}")
            return
        if isinstance(reply, Lease):
            self.leases[run] = reply.lease
            if reply.state == "failed":
                self.nonces[run] = secrets.token_bytes(16)
        kind = reply.code if isinstance(reply, Refused) else type(reply).__name__
        self.seen[kind] += 1


def test_a_server_takes_any_message(tmp_path: Path) -> None:
    with serving(tmp_path, capacity=2) as server, Peer(server, "ada") as honest:
        with Peer(server, "fuzz") as peer:
            fuzz, pid, begun = ServerFuzz(peer), server.process.pid, time.monotonic()
            first = 0.0
            while (passed_s := time.monotonic() - begun) < SECONDS:
                fuzz.step()
                if not first and passed_s > SECONDS / 10:
                    first = memory_mb(pid)
            honest.offer_s()
            last = memory_mb(pid)
        print(
            f"seed {SEED}: {sum(fuzz.seen.values())} answers, {first:.0f} -> {last:.0f} MB"
        )
        print(dict(fuzz.seen))
        log = server.err.read_text()
        assert server.process.poll() is None, log
        assert "Traceback" not in log
        assert "sending_failed" not in log
        assert fuzz.wrong == []
        assert last < first + MEMORY_MB
        enough = {
            "malformed",
            "Lease",
            "Offer",
            "Done",
            "lease-lost",
            "Outcomes",
            "unsupported",
        }
        assert enough <= set(fuzz.seen), "too little happens"


@pytest.mark.parametrize("controller", ["server", "optimizer"])
def test_an_optimizer_takes_any_answer(controller: str, tmp_path: Path) -> None:
    """It may end, with one line; it is started again then."""
    draw, begun, ended = random.Random(SEED), time.monotonic(), Counter[str]()
    grown, first, runs = 0.0, 0.0, 0
    with FakeServers(draw) as fake:
        while (rest_s := begun + SECONDS - time.monotonic()) > 0:
            run = start(tmp_path, fake, controller, f"ot-{(runs := runs + 1)}")
            try:
                run.begin()
                first = 0.0
                while run.process.poll() is None and time.monotonic() < begun + SECONDS:
                    time.sleep(0.1)
                    used = used_mb(run.process.pid)
                    first = first or used
                    grown = max(grown, used - first)
                text = run.err.read_text()
                assert "Traceback" not in text, text[-3_000:]
                if run.process.poll() is not None:
                    code, last = run.process.returncode, text.strip().splitlines()[-1:]
                    ended[f"{code} {last}"[:160]] += 1
                    assert code in (0, 1, 4), text[-3_000:]
            finally:
                run.close()
            assert rest_s
        print(f"seed {SEED}: {fake.answered} answers, {runs} runs, +{grown:.0f} MB")
        print(dict(fake.asked), *ended.items(), sep="\n")
        assert fake.wrong == []
        assert {"offer", "reserve", "evaluate"} <= set(fake.asked), "too little happens"
    assert grown < MEMORY_MB


class Run(Optimizer):
    """A run, which is known to have begun by what it writes."""

    def begin(self) -> None:
        wait_until(
            lambda: self.process.poll() is not None or self.out.read_text(),
            "it begins",
            LONGEST_S,
        )


def start(folder: Path, fake: FakeServers, controller: str, name: str) -> Run:
    options: dict[str, Any] = {
        "generations": 1_000_000,
        "optimizer.population": 20,
        "cluster.controller": controller,
        "cluster.on_fault": "quarantine",
        "cluster.trial_timeout_s": 2,
    }
    sets = [
        part for key, value in options.items() for part in ("--set", f"{key}={value}")
    ]
    command = ["run", "xor", "--json", "--servers", "1", "--no-multicast"]
    return Run(
        folder, name, [*command, "--connect", fake.endpoint, *sets], ZSWARM_PLAIN="1"
    )


def used_mb(pid: int) -> float:
    try:
        return memory_mb(pid)
    except psutil.NoSuchProcess:
        return 0.0
