"""One who sends much, or much at once, does not stop a server's service to others."""

import os
import secrets
import time
from pathlib import Path

import msgspec
import psutil
import pytest

from tests.attacks.peer import Peer, cpu_s, memory_mb, reserve, serving
from tests.integration.programs import Program
from tests.repository import REPOSITORY
from zswarm.protocol import codec, messages
from zswarm.protocol.messages import Lease, Refused, Renew
from zswarm.ss.slots.leases import MAX_LEASES_OF_USER

pytestmark = pytest.mark.attacks

NOTHING = 8 << 20  # empty lists, of a byte each
# Generous where this machine computes much else; the numbers of an idle one are printed.
ANSWERED_S = 20.0
LONGEST_S = 300.0
MANY = 20_000  # answers, which no buffer of a link holds


def settings(count: int) -> msgspec.Raw:
    """Return settings with a list of so many empty lists."""
    return msgspec.Raw(b"\x81\xa1a\xdd" + count.to_bytes(4, "big") + b"\x90" * count)


def empty(verb: str, count: int) -> bytes:
    """Return a request that is large and says nothing."""
    fields = {
        "offer": {"type": "requirements", "settings": settings(count)},
        "reserve": msgspec.to_builtins(reserve(), builtin_types=(bytes,))
        | {"simulator": {"kind": "xor", "settings": settings(count)}},
        "renew": {"type": "renew", "lease": bytes(16), "later": settings(count)},
        "cancel": {"type": "cancel", "lease": bytes(16), "later": settings(count)},
        "release": {"type": "release", "lease": bytes(16), "later": settings(count)},
        "evaluate": {
            "type": "evaluate",
            "lease": bytes(16),
            "batch": 1,
            "later": settings(count),
        },
    }
    return msgspec.msgpack.encode(fields[verb])


def slowest_s(honest: Peer, ended: list[list[bytes | None]], but: int = 0) -> float:
    """Ask small questions until all but some queries ended; return the longest wait."""
    slowest, end = 0.0, time.monotonic() + LONGEST_S
    while sum(map(bool, ended)) < len(ended) - but:
        assert time.monotonic() < end, f"{sum(map(bool, ended))} of {len(ended)} ended"
        slowest = max(slowest, honest.offer_s())
    return slowest


def test_large_messages_of_nothing_delay_nobody(tmp_path: Path) -> None:
    """They took 2.5 to 6.5 s of computing each, and 550 MB."""
    with (
        serving(tmp_path) as server,
        Peer(server, "mallory") as mallory,
        Peer(server, "ada") as ada,
    ):
        for verb in messages.MAX_REQUEST:
            before, used = cpu_s(server), memory_mb(server.process.pid)
            ended = [mallory.send(verb, empty(verb, NOTHING)) for _ in range(5)]
            delay_s = slowest_s(ada, ended)
            used_s = cpu_s(server) - before
            print(f"5 x 8 MB to {verb}: honest {delay_s:.2f} s, {used_s:.2f} s computed")
            assert delay_s < ANSWERED_S
            assert used_s < 2.5, verb
            assert memory_mb(server.process.pid) < used + 100, verb
            for (answer,) in ended:
                assert answer is not None
                refused = codec.decode_reply(answer)
                assert isinstance(refused, Refused)
                assert refused.code == (
                    "lease-lost" if verb == "evaluate" else "malformed"
                )


def test_many_of_the_largest_settings_delay_nobody(tmp_path: Path) -> None:
    """Each has the most values that 64 kB hold."""
    with (
        serving(tmp_path) as server,
        Peer(server, "mallory") as mallory,
        Peer(server, "ada") as ada,
    ):
        body = empty("reserve", messages.MAX_REQUEST["reserve"] - 300)
        before, begun = cpu_s(server), time.monotonic()
        ended = [mallory.send("reserve", body, f"run-{n}") for n in range(200)]
        delay_s = slowest_s(ada, ended)
        took_s = time.monotonic() - begun
        assert isinstance(ada.ask(reserve()), Lease)
        used_s = cpu_s(server) - before
        print(f"200 x 64 kB: honest {delay_s:.2f} s, {used_s:.2f} s computed")
        assert delay_s < took_s / 3, "users take turns"


def test_a_message_beyond_the_limit_of_the_link_reaches_nobody(tmp_path: Path) -> None:
    with serving(tmp_path) as server, Peer(server, "ada") as ada:
        with Peer(server, "mallory") as mallory:
            used = memory_mb(server.process.pid)
            for _ in range(3):
                mallory.send("evaluate", bytes(60 << 20), timeout_s=5.0)
            ada.offer_s()
            assert memory_mb(server.process.pid) < used + 200
        ada.offer_s()


def test_a_user_cannot_have_a_thousand_leases(tmp_path: Path) -> None:
    with (
        serving(tmp_path) as server,
        Peer(server, "mallory") as mallory,
        Peer(server, "ada") as ada,
    ):
        ended = [
            mallory.send("reserve", codec.encode(reserve()), f"run-{n}")
            for n in range(1_000)
        ]
        delay_s = slowest_s(ada, ended)
        assert isinstance(ada.ask(reserve()), Lease)
        replies = [
            codec.decode_reply(answer) for (answer,) in ended if answer is not None
        ]
        granted = [reply for reply in replies if isinstance(reply, Lease)]
        refused = [reply.code for reply in replies if isinstance(reply, Refused)]
        print(f"1000 leases: honest {delay_s:.2f} s, {len(granted)} granted")
        assert (len(granted), set(refused)) == (MAX_LEASES_OF_USER, {"busy"})
        assert len(refused) == 1_000 - MAX_LEASES_OF_USER
        assert delay_s < ANSWERED_S
        assert len(server.events("lease_granted")) == MAX_LEASES_OF_USER + 1


def test_a_lease_does_not_hold_thousands_of_renewals(tmp_path: Path) -> None:
    """All but the latest are answered, or dropped, at once."""
    with (
        serving(tmp_path) as server,
        Peer(server, "mallory") as mallory,
        Peer(server, "ada") as ada,
    ):
        lease = mallory.ask(reserve())
        while not (isinstance(lease, Lease) and lease.state == "ready"):
            assert isinstance(lease, Lease)
            lease = mallory.ask(Renew(lease=lease.lease, known_ready=lease.ready))
        body = codec.encode(Renew(lease=lease.lease, known_ready=lease.ready))
        before = cpu_s(server)
        ended = [mallory.send("renew", body) for _ in range(5_000)]
        delay_s = slowest_s(ada, ended, but=4)
        used_s = cpu_s(server) - before
        print(f"5000 renewals: honest {delay_s:.2f} s, {used_s:.2f} s computed")
        assert delay_s < ANSWERED_S
        assert used_s < 2.5


def test_tokens_of_made_up_runs_delay_nobody(tmp_path: Path) -> None:
    with (
        serving(tmp_path) as server,
        Peer(server, "mallory") as mallory,
        Peer(server, "ada") as ada,
    ):
        liveliness = mallory.session.liveliness()
        for _ in range(5_000):
            name = f"zswarm/v1/default/ot/mallory/{secrets.token_hex(4)}/alive"
            liveliness.declare_token(name).undeclare()
        assert ada.offer_s() < ANSWERED_S


def test_requests_under_made_up_names_start_few_threads(tmp_path: Path) -> None:
    """Each run has a thread for its answers."""
    with (
        serving(tmp_path) as server,
        Peer(server, "mallory") as mallory,
        Peer(server, "ada") as ada,
    ):
        process = psutil.Process(server.process.pid)
        before, ended = process.num_threads(), []
        for number in range(2_000):
            body = codec.encode(Renew(lease=bytes(16)))
            ended.append(mallory.send("renew", body, f"run-{number}"))
        assert slowest_s(ada, ended) < ANSWERED_S
        threads = process.num_threads() - before
        print(f"2000 names: {threads} threads")
        assert threads < 300


def test_one_who_takes_no_answers_delays_no_offer(tmp_path: Path) -> None:
    """The answers to offers share a thread, which must not wait for its link."""
    with serving(tmp_path) as server, Peer(server, "ada") as ada:
        command = ["-m", "tests.attacks.deaf", server.endpoint, ada.server]
        path = os.pathsep.join([str(REPOSITORY), os.environ.get("PYTHONPATH", "")])
        deaf = Program(tmp_path, "deaf", command, PYTHONPATH=path)
        try:
            begun, slowest = time.monotonic(), 0.0
            while not asked(deaf) > MANY:
                slowest = max(slowest, ada.offer_s())
                assert deaf.process.poll() is None, deaf.err.read_text()
                assert time.monotonic() < begun + LONGEST_S, f"asked {asked(deaf)} times"
                time.sleep(0.1)
            print(f"{asked(deaf)} offers without taking answers: honest {slowest:.2f} s")
            assert slowest < ANSWERED_S
        finally:
            deaf.close()


def asked(deaf: Program) -> int:
    return int((deaf.out.read_text().split() or ["0"])[-1])
