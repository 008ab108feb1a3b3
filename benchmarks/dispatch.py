"""What it costs to have a candidate evaluated by zswarm and by others, measured side by side: `make bench-peers`.

- no-op: microseconds per candidate, 400 distinct candidates of 1152 bytes per generation, four worker processes;
- sleep: efficiency where each candidate sleeps 5 ms: ideal time / time;
- first result: seconds from the start of a new Python process to the first answer.

Each round starts every peer in a process of its own, has it warm up, measures, and stops it before the next one starts, so that
none idles beside another; the order shifts from round to round. Written are medians over the rounds, with the smallest and the
greatest. Every answer is compared with what it must be. Nothing else should run meanwhile.
"""

import argparse
import importlib.metadata
import json
import os
import platform
import re
import signal
import statistics
import struct
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import quick
from by_mqtt import mosquitto
from peers import BY_ITSELF, PEERS, Way
from work import SLEEP_S

HERE = Path(__file__).parent
BUILD = HERE.parent / "build"
POPULATION, SLOTS, ROUNDS = 400, 4, 5
WARM, WARM_S = 3, 1.0  # generations before anything is measured: so many at least, and for so long
GENERATIONS, GENERATIONS_S = 3, 1.5  # measured in one round: so many, or as many as that takes
QUIET = 0.5  # the load of a machine that does nothing else
PEER_S = 120.0  # in one round, before it is ended


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--rounds", type=int, default=ROUNDS, help=f"[default: {ROUNDS}]")
    parser.add_argument("--population", type=int, default=POPULATION, help=f"[default: {POPULATION}]")
    parser.add_argument("--slots", type=int, default=SLOTS, help=f"worker processes [default: {SLOTS}]")
    parser.add_argument("--warm-s", type=float, default=WARM_S, help=f"of each peer, in each round [default: {WARM_S:g}]")
    parser.add_argument("--only", help=f"peers, with commas between [default: all of {', '.join(PEERS)}]")
    parser.add_argument("--out", type=Path, default=BUILD / "peers.json", help="[default: build/peers.json]")
    parser.add_argument("--one", help=argparse.SUPPRESS)  # measures one peer once, and prints JSON
    parser.add_argument("--begun", type=float, help=argparse.SUPPRESS)  # time.monotonic() of the start of this process
    options = parser.parse_args()
    if options.one:
        print(json.dumps(measured(options)))
        return
    names = options.only.split(",") if options.only else list(PEERS)
    if unknown := set(names) - set(PEERS):
        parser.error(f"no such peer: {', '.join(sorted(unknown))}; there are {', '.join(PEERS)}")
    if (load := os.getloadavg()[0]) > QUIET:
        print(f"the load is {load:.1f}: something else runs here, and the figures will be worse than they are")
    begin = time.monotonic()
    rounds = [one_round(number, names, options) for number in range(options.rounds)]
    found = {
        "machine": machine(),
        "versions": versions(names),
        "population": options.population,
        "slots": options.slots,
        "sleep_s": SLEEP_S,
        "seconds": round(time.monotonic() - begin, 1),
        "rounds": rounds,
    }
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(json.dumps(found, indent=1) + "\n")
    text = markdown(found)
    options.out.with_suffix(".md").write_text(text)
    print(f"\n{text}\n{options.out} and .md, {found['seconds']:.0f} s")


def one_round(number: int, names: list[str], options: argparse.Namespace) -> dict[str, Any]:
    """Every peer once; what it said by its name."""
    turn = number * len(names) // max(1, options.rounds)
    result: dict[str, Any] = {"load": os.getloadavg()[0]}
    print(f"round {number + 1} of {options.rounds}, load {result['load']:.1f}", flush=True)
    for name in [*names[turn:], *names[:turn]]:
        begin = time.monotonic()
        result[name] = in_own_process(name, options)
        words = f"  not measured: {result[name]['missing']}" if "missing" in result[name] else ""
        print(f"  {name:<22} {time.monotonic() - begin:5.1f} s{words}", flush=True)
    return result


def in_own_process(name: str, options: argparse.Namespace) -> dict[str, Any]:
    """What a process of its own measures; ``missing``: why it did not."""
    command = [sys.executable, str(HERE / "dispatch.py"), "--one", name, "--begun", repr(time.monotonic())]
    command += ["--population", str(options.population), "--slots", str(options.slots), "--warm-s", str(options.warm_s)]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(HERE), os.environ.get("PYTHONPATH", "")])}
    process = subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    try:
        said, errors = process.communicate(timeout=PEER_S)
    except BaseException as error:  # Ctrl-C too: nothing of it stays
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        if isinstance(error, subprocess.TimeoutExpired):
            return {"missing": f"took more than {PEER_S:g} s"}
        raise
    if process.returncode:
        last = (errors.strip().splitlines() or [f"exit code {process.returncode}"])[-1]
        return {"missing": why_not_installed(name) or last.removeprefix("FileNotFoundError: ")}
    return json.loads(said.splitlines()[-1])


def why_not_installed(name: str) -> str:
    """What pip said, where it could not install the peer."""
    refused = BUILD / "peers" / f"{PEERS[name].distribution}.refused"
    return refused.read_text(errors="replace").strip() if refused.exists() else ""


def measured(options: argparse.Namespace) -> dict[str, Any]:
    """One peer, from start to stop."""
    population, slots = options.population, options.slots
    with PEERS[options.one].peer(slots) as ways:
        checked(ways[0], quick.random_genomes(1), False)
        first_s = time.monotonic() - options.begun
        warm: list[float] = []
        while len(warm) < WARM or sum(warm) < options.warm_s:
            warm.append(checked(ways[0], quick.random_genomes(population), False))
        found = [{"form": way.form, "chunk": way.chunk, **costs(way, population, slots)} for way in ways]
    return {"first_s": first_s, "ways": found}


def costs(way: Way, population: int, slots: int) -> dict[str, Any]:
    """Microseconds per no-op and efficiency with sleeps, each after a generation that does not count."""
    size = min(population, way.most)
    checked(way, quick.random_genomes(size), False)
    times: list[float] = []
    while len(times) < GENERATIONS and sum(times) < GENERATIONS_S:
        times.append(checked(way, quick.random_genomes(size), False))
    found: dict[str, Any] = {"candidates": size, "noop_us": statistics.median(times) / size * 1e6}
    if way.sleeps:
        checked(way, quick.random_genomes(size // 4), True)
        found["efficiency"] = size * SLEEP_S / slots / checked(way, quick.random_genomes(size), True)
    return found


def checked(way: Way, genomes: list[bytes], sleeping: bool) -> float:
    """Seconds for a generation whose answers are right."""
    begin = time.perf_counter()
    fitness = way.evaluate(genomes, sleeping)
    elapsed = time.perf_counter() - begin
    if fitness != [struct.unpack_from("<f", genome)[0] for genome in genomes]:
        raise AssertionError(f"{way.form}: a candidate got another's fitness")
    return elapsed


def markdown(found: dict[str, Any]) -> str:
    """The table, and what it was measured with."""
    rounds = found["rounds"]
    names = [name for name in PEERS if name in rounds[0]]
    rows, missing, ours = [], [], None
    for name in names:
        done = [one[name] for one in rounds if "missing" not in one[name]]
        if len(done) < len(rounds):
            reasons = {one[name]["missing"] for one in rounds if "missing" in one[name]}
            missing.append(
                f"- {name}: not measured in {len(rounds) - len(done)} of {len(rounds)} rounds: {'; '.join(sorted(reasons))}"
            )
        for at, way in enumerate(done[0]["ways"] if done else []):
            of_way = [one["ways"][at] for one in done]
            noop = statistics.median(one["noop_us"] for one in of_way)
            ours = noop if ours is None and name == "zswarm" else ours
            rows.append(
                (
                    name if at == 0 else "",
                    way["form"],
                    "by itself" if way["chunk"] == BY_ITSELF else str(way["chunk"]),
                    spread([one["noop_us"] for one in of_way], us),
                    f"{noop / ours:.1f}" if ours else "",
                    spread([one["efficiency"] for one in of_way], share) if "efficiency" in way else "",
                    spread([one["first_s"] for one in done], "{:.1f}".format) if at == 0 else "",
                )
            )
    head = (
        "",
        "form",
        "candidates in a message",
        "no-op, us per candidate",
        "times zswarm",
        "efficiency at 5 ms",
        "first result, s",
    )
    lines = ["| " + " | ".join(row) + " |" for row in (head, ("---",) * len(head), *rows)]
    packages = ", ".join(f"{name} {version}" for name, version in found["versions"].items())
    loads = [one["load"] for one in rounds]
    return "\n".join(
        [
            *lines,
            "",
            *missing,
            *([""] if missing else []),
            f"{found['machine']}; load {min(loads):.1f} to {max(loads):.1f} when a round began. {packages}. "
            f"{found['population']} candidates, {found['slots']} worker processes; medians of {len(rounds)} rounds "
            "(smallest to greatest).",
            "",
        ]
    )


def spread(values: list[float], written: Callable[[float], str]) -> str:
    """The median, and from where to where."""
    return f"{written(statistics.median(values))} ({written(min(values))} to {written(max(values))})"


def us(value: float) -> str:
    """Microseconds: three digits or more."""
    return f"{value:,.1f}" if value < 100 else f"{value:,.0f}"


def share(value: float) -> str:
    """As .957."""
    return f"{value:.3f}".removeprefix("0")


def machine() -> str:
    """Its cores and systems."""
    cpu = platform.machine()
    text = Path("/proc/cpuinfo").read_text() if Path("/proc/cpuinfo").exists() else ""
    if named := re.search(r"^model name\s*: (.+)$", text, re.MULTILINE):
        cpu = named[1].strip()
    cores = len(os.sched_getaffinity(0))
    return f"{cores} cores of {cpu}, {platform.system()} {platform.release()}, Python {platform.python_version()}"


def versions(names: list[str]) -> dict[str, str]:
    """Of what was measured, where it is installed."""
    found = {}
    for distribution in dict.fromkeys(["eclipse-zenoh", *(PEERS[name].distribution for name in names)]):
        try:
            found[distribution] = importlib.metadata.version(distribution) if distribution else ""
        except importlib.metadata.PackageNotFoundError:
            continue
    found.pop(None, None)
    if "paho-mqtt" in found:
        try:
            said = subprocess.run([mosquitto(), "-h"], capture_output=True, text=True, check=False).stdout
            found["mosquitto"] = said.splitlines()[0].split()[-1]
        except (OSError, IndexError):
            pass
    return found


if __name__ == "__main__":
    main()
