"""Measure the paper's designs and zswarm's, and write docs/paper.md: `make paper`.

Nothing else should run meanwhile. Needs mosquitto and gcc; with ROS 1's catkin the compilation is
timed as the paper's was.
"""

import argparse
import json
import sys
from pathlib import Path

import machine

from paper import charts, page

HERE = Path(__file__).resolve().parent
REPOSITORY = HERE.parents[1]
NEEDS = ("mosquitto", "gcc")  # programs, which are in Debian's packages of their names


def main() -> None:
    """Measure, write, draw."""
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument(
        "--quick",
        action="store_true",
        help="small sizes: whether it works; changes nothing else",
    )
    parser.add_argument(
        "--to",
        type=Path,
        help="a folder for all of it [default: the repository; with --quick build/paper]",
    )
    parser.add_argument(
        "--page",
        action="store_true",
        help="measure nothing: make the page of results.json",
    )
    options = parser.parse_args()
    to = options.to or (REPOSITORY / "build" / "paper" if options.quick else None)
    folder, to = (to, to) if to else (HERE, REPOSITORY)
    if not options.page:
        if missing := [name for name in NEEDS if not machine.program_of(name)]:
            print(
                f"not installed: {', '.join(missing)} (Debian: apt install {' '.join(missing)})",
                file=sys.stderr,
            )
            sys.exit(2)
        from paper import measure

        measure.results(measure.QUICK if options.quick else measure.Plan(), folder)
    results = json.loads((folder / "results.json").read_text(encoding="utf-8"))
    pictures = to / "docs" / "pictures"
    pictures.mkdir(parents=True, exist_ok=True)
    charts.draw(results, pictures)
    (to / "docs" / "paper.md").write_text(page.document(results), encoding="utf-8")
    print(f"{folder / 'results.json'}, {to / 'docs' / 'paper.md'}")


if __name__ == "__main__":
    main()
