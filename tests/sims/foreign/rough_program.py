"""Simulate without zswarm, and go wrong as the argument says.

One agent observes the seed of the trial; fitness is the sum of its actions in three turns. It
goes wrong in the trial with seed 1;
of several things, separated by commas, seed 2 is that of the second, and so on.
"""

import os
import signal
import struct
import subprocess
import sys
import time

import msgspec

HOW = sys.argv[1]
EACH = HOW.split(",")
out = os.fdopen(1, "wb", closefd=False)  # with a buffer, whatever the environment says


def say(**message: object) -> None:
    write(**message)
    out.flush()


def write(**message: object) -> None:
    """Queue a line, which is sent with the next one."""
    body = msgspec.msgpack.encode(message)
    out.write(struct.pack("<I", len(body)) + body)


def shout(text: str) -> None:
    """Send a line where messages belong."""
    out.write(f"{text}\n".encode())
    out.flush()


def hear() -> dict:
    head = sys.stdin.buffer.read(4)
    if len(head) < 4:
        if HOW == "stays":  # although the reader is gone
            time.sleep(1000)
        sys.exit()
    return msgspec.msgpack.decode(sys.stdin.buffer.read(struct.unpack("<I", head)[0]))


SETTINGS = {
    "bad-default": [{"name": "steps", "type": "int", "default": 0, "minimum": 1}],
    "bad-name": [{"name": "Steps!", "type": "int", "default": 1}],
    "twice": [{"name": "steps", "type": "int", "default": 1}] * 2,
}.get(
    HOW,
    [
        {
            "name": "steps",
            "type": "int",
            "default": 3,
            "minimum": 1,
            "maximum": 9,
            "description": "turns of a trial",
        },
        {"name": "speed", "type": "float", "default": 0.5},
        {"name": "walls", "type": "bool", "default": False},
        {"name": "task", "type": "text", "default": "sum", "choices": ["sum", "none"]},
    ],
)

match HOW:
    case "ends-at-once":
        sys.exit("no licence\nfound")
    case "prints-first":
        shout("Welcome to my simulator")
    case "other-version":
        say(type="hello", v=7)
    case "ready-first":
        say(type="ready", inputs=1, outputs=1, owners=[0])
    case "silent":
        time.sleep(1000)
say(
    type="hello", v=1, description="Sums up.\n\nObservation: the seed.", settings=SETTINGS
)

child = None
while True:
    message = hear()
    match message["type"]:
        case "setup":
            settings = message["settings"]
            if settings["task"] == "none":
                say(type="error", text="there is nothing to do")
                continue
            say(
                type="ready",
                inputs=1,
                outputs=1,
                owners=[2 if HOW == "bad-owner" else 0],
                metrics=["turns", "again"],
                sensors=["a", "b"] if HOW == "bad-sensors" else ["seed"],
                first_seed=5 if HOW == "first-seed" else 1 if EACH[1:] else None,
                hosts=HOW == "hosts" and message["network"] is not None,
            )
            again = 0
            continue
        case "evaluate":
            say(
                type="end",
                fitness=[float(len(message["genomes"][0]))],
                metrics=[0.0, 0.0],
            )
            continue
        case "reset":
            seed, turns, total, again = message["seed"], 0, 0.0, again + 1
        case "actions":
            total += struct.unpack("<f", message["actions"])[0]
            turns += 1
    fitness, agents, observations = [total], [0], struct.pack("<f", seed)
    if 1 <= seed <= len(EACH) and turns == 1:
        match EACH[seed - 1]:
            case "exits":
                sys.stderr.write("cannot load map\n")
                sys.exit(7)
            case "is-killed":
                os.kill(os.getpid(), signal.SIGKILL)
            case "hangs":
                signal.signal(signal.SIGTERM, signal.SIG_IGN)
                time.sleep(1000)
            case "eats":
                eaten = bytearray(600 << 20)
            case "says-twice":
                write(type="turn", agents=agents, observations=observations)
            case "closes":
                os.close(1)
                time.sleep(1000)
            case "prints":
                shout("\x1b[31magent 0 is here")
            case "prints-little":
                shout("1")
            case "long-frame":
                out.write(struct.pack("<I", 2**31))
                out.flush()
            case "cut-frame":
                out.write(struct.pack("<I", 100) + b"\x81")
                out.flush()
                sys.exit(0)
            case "no-message":
                say(type="turn", agents=["first"], observations=b"")
            case "other-message":
                say(type="ready", inputs=1, outputs=1, owners=[0])
            case "leaves-a-child":  # which holds its standard output open
                subprocess.Popen(["sleep", "1000"])
                sys.exit(3)
            case "floods":
                for _ in range(100):
                    sys.stderr.write("warning: slow\n" * 1000)
            case "error":
                say(type="error", text="the map is\tclosed")
                continue
            case "short":
                observations = b"\0\0"
            case "no-agent":
                agents = [1]
            case "nan":
                total = float("nan")
            case "two-fitnesses":
                fitness = [1.0, 2.0]
                turns = settings["steps"]
    if turns == settings["steps"]:
        say(
            type="end",
            fitness=fitness,
            metrics=[turns, again if HOW != "fine" and not EACH[1:] else 0],
        )
    else:
        say(type="turn", agents=agents, observations=observations)
