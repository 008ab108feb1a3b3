"""Play fresh schedules until the time is up (``make chaos``), or replay one with ``SEED=17``."""

import argparse
import concurrent.futures
import os
import secrets
import sys
import time

from .schedule import play

CHUNK = 5


def failures(seeds: range) -> list[str]:
    """Return the failures as text."""
    found = []
    for seed in seeds:
        try:
            play(seed)
        except AssertionError as error:
            found.append(str(error))
    return found


def main() -> int:
    """Run the program and return its exit code."""
    parser = argparse.ArgumentParser(prog="make chaos", description=__doc__)
    parser.add_argument("--seed", type=int, help="replay this one schedule")
    parser.add_argument("--first", type=int, help="of many schedules [default: random]")
    parser.add_argument("--seconds", type=float, default=300.0, help="how long to look")
    options = parser.parse_args()
    if options.seed is not None:
        world = play(options.seed).world
        print(
            f"seed {options.seed}: every rule held, {world.now:.0f} s of simulated time"
        )
        return 0
    base = secrets.randbits(48) if options.first is None else options.first
    begin, played = time.monotonic(), 0
    print(f"schedules from {base} on, for {options.seconds:g} s")
    with concurrent.futures.ProcessPoolExecutor() as pool:
        while time.monotonic() - begin < options.seconds:
            chunks = [
                range(base + played + i * CHUNK, base + played + (i + 1) * CHUNK)
                for i in range(os.cpu_count() or 1)
            ]
            found = [text for chunk in pool.map(failures, chunks) for text in chunk]
            played += len(chunks) * CHUNK
            if found:
                print("\n\n".join(found))
                return 1
    print(f"{played} schedules in {time.monotonic() - begin:.0f} s: every rule held")
    return 0


sys.exit(main())
