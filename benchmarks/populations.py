"""Measure the optimizer's time of a generation, and its memory, in large populations.

NNGA with networks of 53 genes and a record of the best candidates, as usual, without servers: a
trial costs nothing (``large_genomes.py``). The first generation, which has no parents, is left out.
"""

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

import machine
import tables

HERE = Path(__file__).resolve().parent
GENES = 81  # as large_genomes.py counts: a network of 53
GENERATIONS = {50: 100, 1_000: 20, 8_000: 6, 100_000: 4}  # by population


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument(
        "--quick", action="store_true", help="the smallest only: whether it works"
    )
    parser.add_argument(
        "--folder", type=Path, help="where the results go [default: build/bench]"
    )
    options = parser.parse_args()
    machine.warn_if_busy()
    machine.RESULTS.mkdir(parents=True, exist_ok=True)
    begin, rows = time.monotonic(), []
    for population in [50] if options.quick else GENERATIONS:
        asked = [population, GENES, GENERATIONS[population], "nnga", "best"]
        said = subprocess.run(
            [sys.executable, HERE / "large_genomes.py", *map(str, asked)],
            stdout=subprocess.PIPE,
            check=True,
            cwd=machine.RESULTS,  # the folder of the run is there, on a real disk
        ).stdout
        found = json.loads(said)
        rows.append(
            {
                "population": population,
                "genes": found["genes"],
                "generation_s": found["generation_s"],
                "mb": found["memory_mb"],
            }
        )
    seconds = round(time.monotonic() - begin)
    file = machine.write("populations", rows, folder=options.folder, seconds=seconds)
    print(f"{tables.populations(json.loads(file.read_text()))}\n{file}, {seconds} s")


if __name__ == "__main__":
    main()
