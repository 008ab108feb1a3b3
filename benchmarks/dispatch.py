"""Measure what it costs to have a candidate evaluated by zswarm and by others.

Generations of distinct candidates of 1152 bytes do nothing (*noop*), sleep 5 ms (*sleep*) or take
5 ms of a core (*cpu*). The first gives microseconds per candidate, the others efficiency: ideal
time / time. Each round starts every peer in its own process, warms it up, measures it, and stops it
before the next one starts, so that none idles next to another; the order shifts from round to
round. The results are medians over the rounds, with least and most. Every answer is checked.
Nothing else should run meanwhile.
"""

import argparse
import json
import os
import signal
import statistics
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import leased
import machine
import tables
from peers import PEERS, QUARTERS, WHOLES, Way, chunk
from usage import tree_mb
from work import WORKS, ideal_s

HERE = Path(__file__).resolve().parent
PEERS_FOLDER = HERE.parent / "build" / "peers"
POPULATIONS, SLOTS, ROUNDS = (50, 400), (1, 2, 4, 8, 16), 3
WHOLE = 4, 400  # the slots and the population that all ways are measured with
WARM, GENERATIONS = 3, 5  # at least so many to warm up, at most so many in a measurement
SECONDS = 0.5  # that each of the two takes
PEER_S = 180.0  # in one round, before it is ended


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--rounds", type=int, default=ROUNDS, help=f"[default: {ROUNDS}]")
    parser.add_argument(
        "--populations",
        type=numbers,
        default=POPULATIONS,
        help=f"[default: {shown(POPULATIONS)}]",
    )
    parser.add_argument(
        "--slots",
        type=numbers,
        default=SLOTS,
        help=f"worker processes [default: {shown(SLOTS)}]",
    )
    parser.add_argument(
        "--seconds",
        type=float,
        default=SECONDS,
        help=f"to warm up, and of each measurement in a round [default: {SECONDS:g}]",
    )
    parser.add_argument(
        "--only", help=f"peers, with commas between [default: all of {', '.join(PEERS)}]"
    )
    parser.add_argument(
        "--quick",
        action="store_true",
        help="one round of 50 candidates on 4 slots: whether it works",
    )
    parser.add_argument(
        "--folder", type=Path, help="where the results go [default: build/bench]"
    )
    # Measures one peer once, and prints JSON.
    parser.add_argument("--one", help=argparse.SUPPRESS)
    parser.add_argument("--works", default=",".join(WORKS), help=argparse.SUPPRESS)
    # The time.monotonic() of the start of this process.
    parser.add_argument("--begun", type=float, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        print(json.dumps(measured(options)))
        return
    if options.quick:
        options.rounds, options.seconds = 1, 0.02
        options.slots, options.populations = WHOLE[:1], POPULATIONS[:1]
    names = options.only.split(",") if options.only else list(PEERS)
    if unknown := set(names) - set(PEERS):
        parser.error(
            f"no such peer: {', '.join(sorted(unknown))}; there are {', '.join(PEERS)}"
        )
    machine.warn_if_busy()
    begin = time.monotonic()
    rounds = [one_round(number, names, options) for number in range(options.rounds)]
    rows = summary([row for one in rounds for row in one])
    packages = [package for name in names for package in PEERS[name].distributions]
    file = machine.write(
        "dispatch",
        rows,
        packages,
        folder=options.folder,
        rounds=options.rounds,
        seconds=round(time.monotonic() - begin),
    )
    print(
        f"\n{tables.dispatch(json.loads(file.read_text()))}\n{file}, "
        f"{time.monotonic() - begin:.0f} s"
    )


def numbers(text: str) -> tuple[int, ...]:
    """Return the numbers of a comma-separated option."""
    return tuple(int(each) for each in text.split(",") if each)


def shown(values: tuple[int, ...]) -> str:
    """Format numbers for a help text."""
    return ",".join(map(str, values))


def one_round(
    number: int, names: list[str], options: argparse.Namespace
) -> list[dict[str, Any]]:
    """Measure every peer once with each number of slots."""
    turn = number * len(names) // max(1, options.rounds)
    found = []
    print(
        f"round {number + 1} of {options.rounds}, load {os.getloadavg()[0]:.1f}",
        flush=True,
    )
    for slots in options.slots:
        if slots == 1 and number:
            continue  # once: it takes longest and is least informative
        for name in [*names[turn:], *names[:turn]]:
            if slots not in (PEERS[name].slots or options.slots):
                continue
            begin = time.monotonic()
            rows = in_own_process(name, slots, options.populations, options.seconds)
            found += rows
            words = (
                f"  not measured: {rows[0]['missing']}" if "missing" in rows[0] else ""
            )
            print(
                f"  {slots:>2} slots  {name:<22} {time.monotonic() - begin:5.1f} s{words}",
                flush=True,
            )
    return found


def in_own_process(
    name: str,
    slots: int,
    populations: tuple[int, ...],
    seconds: float,
    works: Sequence[str] = tuple(WORKS),
) -> list[dict[str, Any]]:
    """Measure in a new process and return its rows; a row with ``missing`` says why it failed."""
    command = [
        sys.executable,
        str(HERE / "dispatch.py"),
        "--one",
        name,
        "--begun",
        repr(time.monotonic()),
    ]
    command += [
        "--populations",
        shown(populations),
        "--slots",
        str(slots),
        "--seconds",
        str(seconds),
        "--works",
        ",".join(works),
    ]
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join([str(HERE), os.environ.get("PYTHONPATH", "")])
    }
    process = subprocess.Popen(
        command,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        said, errors = process.communicate(timeout=PEER_S)
    except BaseException as error:  # Ctrl-C too: nothing of it stays
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        if isinstance(error, subprocess.TimeoutExpired):
            return [
                {"peer": name, "slots": slots, "missing": f"took more than {PEER_S:g} s"}
            ]
        raise
    if process.returncode:
        last = (errors.strip().splitlines() or [f"exit code {process.returncode}"])[-1]
        return [
            {
                "peer": name,
                "slots": slots,
                "missing": why_not_installed(name)
                or last.partition("Error: ")[2]
                or last,
            }
        ]
    return json.loads(said.splitlines()[-1])


def why_not_installed(name: str, folder: Path = PEERS_FOLDER) -> str:
    """Return what pip printed if it could not install the peer."""
    refused = [
        folder / f"{distribution}.refused" for distribution in PEERS[name].distributions
    ]
    return " ".join(
        file.read_text(errors="replace").strip() for file in refused if file.exists()
    )


def measured(options: argparse.Namespace) -> list[dict[str, Any]]:
    """Return the rows of one peer from start to stop; without populations, only of its start."""
    name, slots, populations = options.one, options.slots[0], options.populations
    with PEERS[name].peer(slots) as ways:
        checked(ways[0], leased.random_genomes(1), "noop", slots)
        started = {
            "peer": name,
            "slots": slots,
            "first_s": time.monotonic() - options.begun,
        }
        warm: list[float] = []
        while len(warm) < WARM or sum(warm) < options.seconds:
            warm.append(
                checked(
                    ways[0],
                    leased.random_genomes(max(populations, default=50)),
                    "noop",
                    slots,
                )
            )
        started["tree_mb"] = tree_mb(os.getpid())
        rows = [started]
        # One after another: what a way has started may hold what the one before it needs.
        for way in ways:
            rows += [
                {"peer": name, "slots": slots, **cost(way, work, population, options)}
                for work in options.works.split(",")
                for population in populations
                if worth(way, work, population, slots)
            ]
    return rows


def worth(way: Way, work: str, population: int, slots: int) -> bool:
    """Return whether to measure: a core's time needs slots for all cores, or twice as many."""
    cores = len(os.sched_getaffinity(0))
    if work not in way.works or (work == "cpu" and slots not in (cores, 2 * cores)):
        return False
    by_hand = way.cut in (QUARTERS, WHOLES)
    if slots != WHOLE[0]:
        return not (way.aside or by_hand)
    return population == WHOLE[1] or not (way.aside or way.cut == WHOLES)


def cost(
    way: Way, work: str, population: int, options: argparse.Namespace
) -> dict[str, Any]:
    """Return microseconds per no-op, or efficiency, after a generation that does not count."""
    slots, size = options.slots[0], min(population, way.most)
    checked(
        way,
        leased.random_genomes(size if work == "noop" else max(1, size // 4)),
        work,
        slots,
    )
    times: list[float] = []
    while not times or (len(times) < GENERATIONS and sum(times) < options.seconds):
        times.append(checked(way, leased.random_genomes(size), work, slots))
    seconds = statistics.median(times)
    value = (
        {"us": seconds / size * 1e6}
        if work == "noop"
        else {"efficiency": ideal_s(work, size, slots) / seconds}
    )
    return {
        "form": way.form,
        "cut": way.cut,
        "work": work,
        "population": population,
    } | value


def checked(way: Way, genomes: list[bytes], work: str, slots: int) -> float:
    """Return the seconds of a generation, whose answers must be right."""
    size = chunk(way.cut, len(genomes), slots)
    begin = time.perf_counter()
    fitness = way.evaluate(genomes, work, size)
    elapsed = time.perf_counter() - begin
    if fitness != leased.right(genomes):
        raise AssertionError(f"{way.form}: a candidate got another's fitness")
    return elapsed


def summary(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Merge the rows of all rounds: medians, with ``least`` and ``most`` of successful rounds."""
    values = ("us", "efficiency", "first_s", "tree_mb")
    together: dict[tuple[Any, ...], list[dict[str, Any]]] = {}
    for row in rows:
        together.setdefault(
            tuple((key, value) for key, value in row.items() if key not in values), []
        ).append(row)
    found = []
    for key, same in together.items():
        row: dict[str, Any] = dict(key)
        for what in values:
            if all(what in each for each in same):
                numbers = sorted(each[what] for each in same)
                row |= {
                    what: statistics.median(numbers),
                    f"{what}_least": numbers[0],
                    f"{what}_most": numbers[-1],
                }
        found.append(row)
    return found


if __name__ == "__main__":
    main()
