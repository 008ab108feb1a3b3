"""Measure everything and write docs/benchmarks.md: `make bench`, 25 minutes on an idle machine.

Each script is a program of its own, in the environment that has the peers. What it leaves in
``build/bench`` takes the place of what ``results.json`` has of it. With ``--quick`` nothing of the
repository is changed: the page goes to ``build/bench-quick`` and the names of chosen parts.
"""

import argparse
import json
import shutil
import subprocess
import sys
import time
from pathlib import Path

import machine
import page
import results_file

HERE = Path(__file__).resolve().parent
BUILD = HERE.parent / "build"
PYTHON = BUILD / "peers" / "bin" / "python"  # without it, peers are reported as missing
COMMANDS = {
    script: [f"{script}.py"]
    for script in (
        "runs",
        "populations",
        "startup",
        "commands",
        "scaling",
        "kernels",
        "dispatch",
        "questions",
    )
}
COMMANDS["scale"] = ["-m", "scale"]
COMMANDS["many_servers"] = ["many_servers.py"]
COMMANDS["methods"] = ["methods.py"]
COMMANDS["noise"] = ["noise.py"]
ALONE = (
    "commands",
    "questions",
    "populations",
    "scale",
    "many_servers",
    "methods",
    "noise",
)  # without peers: in the environment of this


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    # These measure no time.
    usual = [name for name in COMMANDS if name not in ("methods", "noise")]
    parser.add_argument(
        "--only",
        help=f"parts, with commas between: methods, noise, or [default] {', '.join(usual)}",
    )
    parser.add_argument(
        "--quick",
        action="store_true",
        help="small rounds, some minutes: whether it works",
    )
    options = parser.parse_args()
    names = options.only.split(",") if options.only else usual
    if unknown := set(names) - set(COMMANDS):
        parser.error(
            f"no such part: {', '.join(sorted(unknown))}; there are {', '.join(COMMANDS)}"
        )
    to = BUILD / "-".join(["bench-quick", *(names if options.only else [])])
    if options.quick:  # without what an earlier one left
        shutil.rmtree(to, ignore_errors=True)
    else:
        to = HERE.parent
    folder = to if options.quick else machine.RESULTS
    begin, failed = time.monotonic(), []
    for name in names:
        print(f"\n# {name}\n", flush=True)
        command = [
            sys.executable if name in ALONE or not PYTHON.exists() else PYTHON,
            *COMMANDS[name],
            "--folder",
            folder,
        ]
        if options.quick:
            command += [
                "--quick",
                *(["--chart", to / "scale.png"] if name == "scale" else []),
            ]
        if subprocess.run(command, cwd=HERE, check=False).returncode:
            failed.append(name)
    file = merged(names, folder, to / "results.json" if options.quick else page.RESULTS)
    if options.quick:
        (to / "docs").mkdir(exist_ok=True)
        shutil.copy(HERE.parent / "README.md", to)
    print(
        f"\n# the page, after {(time.monotonic() - begin) / 60:.0f} minutes\n", flush=True
    )
    command = [
        sys.executable,
        HERE / "page.py",
        "--results",
        file,
        "--to",
        to,
        *(["--draft"] if options.quick else []),
    ]
    made = subprocess.run(command, check=False).returncode
    if failed:
        sys.exit(
            f"failed: {', '.join(failed)}; what they left before is still in the page"
        )
    sys.exit(made)


def merged(names: list[str], folder: Path, file: Path) -> Path:
    """Return the previous results, with those measured again replaced."""
    results = json.loads(file.read_text()) if file.exists() else {}
    for name in names:
        if (left := folder / f"{name}.json").exists():
            results[name] = json.loads(left.read_text())
    results_file.write(file, results)
    return file


if __name__ == "__main__":
    main()
