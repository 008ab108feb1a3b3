"""Measure a question of a simulator to controllers at the optimizer, until it has the answer.

One slot of this machine plays minisim, with a question for each turn and with one for each agent;
the time of the same run with controllers at the server is subtracted. Beside them is a query of
zenoh with as many bytes, and its answer, between two programs that do nothing else.
"""

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import machine
import tables
import zenoh

import zswarm

ROUNDS = 3
AGENTS, STEPS, POPULATION, GENERATIONS = 8, 200, 10, 4
QUERIES, KEY = 2000, "question"
WAYS = {"a question for each turn": "turn", "a question for each agent": "agent"}
# As zswarm sends them.
QUERY = {
    "target": zenoh.QueryTarget.ALL,
    "consolidation": zenoh.ConsolidationMode.NONE,
    "congestion_control": zenoh.CongestionControl.BLOCK,
    "priority": zenoh.Priority.INTERACTIVE_LOW,
    "express": True,
}
QUESTION, ANSWER = bytes(4 * 9 * AGENTS + 120), bytes(4 * 2 * AGENTS + 20)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument(
        "--quick",
        action="store_true",
        help="one round, with few questions: whether it works",
    )
    parser.add_argument(
        "--folder", type=Path, help="where the results go [default: build/bench]"
    )
    parser.add_argument("--answer-at", help=argparse.SUPPRESS)  # the other program
    options = parser.parse_args()
    if options.answer_at:
        answer_at(options.answer_at)
        return
    machine.warn_if_busy()
    begin, rounds = time.monotonic(), 1 if options.quick else ROUNDS
    steps, queries = (30, 20) if options.quick else (STEPS, QUERIES)
    found: dict[str, list[float]] = {}
    for _ in range(rounds):
        here_s, count = generations(steps)
        for name, messages in WAYS.items():
            there_s, _ = generations(
                steps,
                controller="optimizer",
                messages=messages,
            )
            asked = count * steps * (AGENTS if messages == "agent" else 1)
            found.setdefault(name, []).append((there_s - here_s) / asked * 1e6)
        found.setdefault("a query of zenoh alone", []).append(query_us(queries))
    rows = [
        {
            "of": name,
            "us": statistics.median(all_),
            "us_least": min(all_),
            "us_most": max(all_),
        }
        for name, all_ in found.items()
    ]
    seconds = round(time.monotonic() - begin)
    file = machine.write(
        "questions", rows, folder=options.folder, rounds=rounds, seconds=seconds
    )
    print(f"{tables.questions(json.loads(file.read_text()))}\n{file}, {seconds} s")


class Clock(zswarm.Logger):
    """Note when generations end, and the evaluations until then."""

    def __init__(self) -> None:
        self.ends: list[tuple[float, int]] = []

    def on_generation(self, generation: zswarm.Generation) -> None:
        """Note a generation."""
        self.ends.append((time.perf_counter(), generation.evaluations))


def generations(steps: int, **cluster: str) -> tuple[float, int]:
    """Return the seconds of all generations but the first, and their evaluations."""
    asked: dict[str, Any] = {
        "name": "questions",
        "seed": 1,
        "generations": GENERATIONS,
        "problem": {
            "simulator": "minisim",
            "trials": 1,
            "settings": {"robots": AGENTS, "steps": steps},
        },
        "representation": {"kind": "fully-meshed"},
        "optimizer": {"kind": "nnga", "population": POPULATION},
        "assessment": {"budget": 0},
        "cluster": {"servers": "local", "local_slots": 1, **cluster},
    }
    clock = Clock()
    with tempfile.TemporaryDirectory() as folder:
        zswarm.run(zswarm.load(asked), out=folder, loggers=[clock])
    (begin_s, before), (end_s, after) = clock.ends[0], clock.ends[-1]
    return end_s - begin_s, after - before


def query_us(queries: int) -> float:
    """Return the time of a query and its answer between two programs, over a socket file."""
    with tempfile.TemporaryDirectory() as folder:
        endpoint = f"unixsock-stream/{folder}/zenoh"
        with (
            zenoh.open(configured(listen=endpoint)) as session,
            subprocess.Popen(
                [sys.executable, __file__, "--answer-at", endpoint], stdin=subprocess.PIPE
            ) as other,
        ):
            done = threading.Semaphore(0)
            on_reply = zenoh.handlers.Callback(
                lambda _: done.release(), lambda: None, indirect=False
            )
            deadline = time.monotonic() + 30.0
            while not done.acquire(timeout=0.1):  # until it is there
                if time.monotonic() > deadline:
                    raise RuntimeError("the other program does not answer")
                session.get(KEY, on_reply, payload=QUESTION, **QUERY)
            time.sleep(0.5)  # until the answers to earlier ones are there
            while done.acquire(blocking=False):
                pass
            begin = time.perf_counter()
            for _ in range(queries):
                session.get(KEY, on_reply, payload=QUESTION, **QUERY)
                done.acquire()
            seconds = time.perf_counter() - begin
            assert other.stdin is not None
            other.stdin.close()
    return seconds / queries * 1e6


def answer_at(endpoint: str) -> None:
    """Answer queries until stdin closes."""

    def answer(query: zenoh.Query) -> None:
        with query:
            query.reply(query.key_expr, ANSWER)

    with zenoh.open(configured(connect=endpoint)) as session:
        callback = zenoh.handlers.Callback(answer, indirect=False)
        session.declare_queryable(KEY, callback)
        sys.stdin.read()


def configured(**endpoints: str) -> zenoh.Config:
    """Return the configuration of a peer without discovery; ``listen`` or ``connect``."""
    config = zenoh.Config()
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("listen/endpoints", "[]")
    for way, endpoint in endpoints.items():
        config.insert_json5(f"{way}/endpoints", json.dumps([endpoint]))
    return config


if __name__ == "__main__":
    main()
