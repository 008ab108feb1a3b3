"""Evaluation over an MQTT broker: what ``peers.py`` measures as MQTT.

A mosquitto of its own on loopback, and a process per slot, each with a connection to it. QoS 0, the
fastest: no message is acknowledged. ``in_parts`` sends whole evaluations and keeps two messages out
per slot, as zswarm does. ``in_steps`` has the messages of the paper's network-based approach: for
each simulation discovery, server (from every idle one), parameters, control and fitness, and a
sensor and an actuator message per agent and step. Nothing is computed for these: their cost is the
messages'.

As a program it is a server: ``by_mqtt.py PORT NUMBER NODELAY``.
"""

import contextlib
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from leased import free_port
from machine import program_of
from work import WORKS

DEPTH = 2  # messages out per slot
AGENTS, STEPS = 8, 50
SENSOR, ACTUATOR = bytes(40), bytes(8)  # ten sensors, two actuators, float32
WAIT_S = 60.0
HEAD = struct.Struct("<IIB")  # number of the message, candidates in it, their work
WORK = {work: number for number, work in enumerate(WORKS)}


def mosquitto() -> str:
    """Return the path of the broker's program."""
    if (found := program_of("mosquitto")) is None:
        raise FileNotFoundError(
            "mosquitto is not installed (Debian: apt install mosquitto)"
        )
    return found


def connected(port: int, nodelay: bool) -> Any:
    """Return a client with its connection open."""
    from paho.mqtt.client import Client
    from paho.mqtt.enums import CallbackAPIVersion

    client = Client(CallbackAPIVersion.VERSION2)
    if nodelay:
        client.on_socket_open = lambda _client, _data, opened: opened.setsockopt(
            socket.IPPROTO_TCP, socket.TCP_NODELAY, 1
        )
    client.connect("127.0.0.1", port)
    return client


class Broker(AbstractContextManager["Broker"]):
    """A mosquitto and a process per slot, and the optimizer's connection, whose thread runs."""

    def __init__(self, slots: int, nodelay: bool) -> None:
        self.slots = slots
        self.nodelay = nodelay

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            port = broker(stack, self.nodelay)
            self.client = connected(port, self.nodelay)
            stack.callback(self.client.disconnect)
            ready, subscribed = threading.Semaphore(0), threading.Event()
            self.client.on_subscribe = lambda *_: subscribed.set()
            self.client.on_message = lambda *_: ready.release()
            self.client.subscribe("ready")
            self.client.loop_start()
            stack.callback(self.client.loop_stop)
            assert subscribed.wait(WAIT_S)
            for number in range(self.slots):
                started(
                    stack,
                    [
                        sys.executable,
                        __file__,
                        str(port),
                        str(number),
                        str(int(self.nodelay)),
                    ],
                )
            for _ in range(self.slots):
                assert ready.acquire(timeout=WAIT_S), "a server did not start"
            subscribed.clear()
            self.client.subscribe(
                [(topic, 0) for topic in ("result", "server", "sensor", "fitness")]
            )
            assert subscribed.wait(WAIT_S)
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stack.close()

    def in_parts(self, genomes: list[bytes], work: str, chunk: int) -> list[float]:
        """Send whole evaluations, ``chunk`` in a message, two messages in flight per slot."""
        parts = [
            genomes[begin : begin + chunk] for begin in range(0, len(genomes), chunk)
        ]
        bodies = [
            HEAD.pack(number, len(part), WORK[work]) + b"".join(part)
            for number, part in enumerate(parts)
        ]
        results: list[Sequence[float]] = [()] * len(parts)
        waiting = iter(bodies)
        left = len(parts)
        done = threading.Event()

        def on_message(client: Any, _data: object, message: Any) -> None:
            nonlocal left
            server, number = struct.unpack_from("<II", message.payload)
            results[number] = struct.unpack_from(
                f"<{len(parts[number])}d", message.payload, 8
            )
            left -= 1
            if (body := next(waiting, None)) is not None:
                client.publish(f"ss/{server}/evaluate", body)
            elif not left:
                done.set()

        self.client.on_message = on_message
        first = [next(waiting, None) for _ in range(DEPTH * self.slots)]
        for message, body in enumerate(first):
            if body is not None:
                self.client.publish(f"ss/{message % self.slots}/evaluate", body)
        assert done.wait(WAIT_S), "MQTT: an answer did not come"
        return [fitness for part in results for fitness in part]

    def in_steps(
        self, genomes: list[bytes], work: str, _chunk: int, *, steps: int
    ) -> list[float]:
        """Send the paper's messages, one simulation at a time per server."""
        results = [0.0] * len(genomes)
        looking: set[int] = set()  # candidates that look for a server
        used: dict[int, int] = {}  # server -> candidate
        waiting = iter(range(len(genomes)))
        left = len(genomes)
        done = threading.Event()

        def begin(client: Any) -> None:
            if (candidate := next(waiting, None)) is not None:
                looking.add(candidate)
                client.publish("discovery", HEAD.pack(candidate, 0, 0))

        def on_message(client: Any, _data: object, message: Any) -> None:
            nonlocal left
            server, candidate = struct.unpack_from("<II", message.payload)
            if message.topic == "sensor":
                client.publish(
                    f"ss/{server}/actuator", HEAD.pack(candidate, 0, 0) + ACTUATOR
                )
            elif message.topic == "server":
                if candidate in looking and server not in used:
                    looking.discard(candidate)
                    used[server] = candidate
                    client.publish(
                        f"ss/{server}/parameters",
                        HEAD.pack(candidate, steps, WORK[work]) + genomes[candidate],
                    )
                    client.publish(
                        f"ss/{server}/control", HEAD.pack(candidate, steps, WORK[work])
                    )
            elif message.topic == "fitness":
                (results[candidate],) = struct.unpack_from("<d", message.payload, 8)
                del used[server]
                left -= 1
                begin(client)
                if not left:
                    done.set()

        self.client.on_message = on_message
        for _ in range(self.slots):
            begin(self.client)
        assert done.wait(WAIT_S), "MQTT: an answer did not come"
        return results


def broker(stack: ExitStack, nodelay: bool) -> int:
    """Start a private mosquitto on loopback until the stack is left; return its port."""
    program, port = mosquitto(), free_port()
    settings = Path(stack.enter_context(tempfile.TemporaryDirectory())) / "mosquitto.conf"
    settings.write_text(
        f"listener {port} 127.0.0.1\nallow_anonymous true\npersistence false\nlog_type none\n"
        f"max_queued_messages 0\nset_tcp_nodelay {'true' if nodelay else 'false'}\n"
    )
    started(stack, [program, "-c", str(settings)])
    wait_for_port(port, WAIT_S)
    return port


def started(stack: ExitStack, command: list[str], stdin: bytes = b"") -> None:
    """Start a program that reads this from its standard input, until the stack is left."""
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL)
    assert process.stdin is not None
    with contextlib.suppress(BrokenPipeError):
        process.stdin.write(stdin)
        process.stdin.close()

    def end() -> None:
        process.terminate()
        try:
            process.wait(5.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

    stack.callback(end)


def wait_for_port(port: int, seconds: float) -> None:
    """Wait until a program listens at a port of this machine."""
    deadline = time.monotonic() + seconds
    while True:
        try:
            socket.create_connection(("127.0.0.1", port), 1.0).close()
            return
        except OSError:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.02)


def serve(port: int, number: int, nodelay: bool) -> None:
    """Serve as a slot: answer whole evaluations and play the paper's simulations until ended."""
    client = connected(port, nodelay)
    me = struct.pack("<I", number)
    genome, turns, busy = b"", 0, False
    judges = list(WORKS.values())

    def on_message(client: Any, _data: object, message: Any) -> None:
        nonlocal genome, turns, busy
        candidate, count, work = HEAD.unpack_from(message.payload)
        body = message.payload[HEAD.size :]
        judge = judges[work]
        who = me + struct.pack("<I", candidate)
        match message.topic.rpartition("/")[2]:
            case "evaluate":
                size = len(body) // count
                fitness = [
                    judge(body[at : at + size]) for at in range(0, len(body), size)
                ]
                client.publish("result", who + struct.pack(f"<{count}d", *fitness))
            case "discovery":
                if not busy:
                    client.publish("server", who)
            case "parameters":
                genome = body
            case "control" | "actuator" as topic:
                turns, busy = (AGENTS * count if topic == "control" else turns - 1), True
                if turns:
                    client.publish("sensor", who + SENSOR)
                else:
                    busy = False
                    client.publish("fitness", who + struct.pack("<d", judge(genome)))

    client.on_message = on_message
    client.on_subscribe = lambda *_: client.publish("ready", me)
    client.subscribe([(f"ss/{number}/#", 0), ("discovery", 0)])
    client.loop_forever()


if __name__ == "__main__":
    serve(int(sys.argv[1]), int(sys.argv[2]), sys.argv[3] == "1")
