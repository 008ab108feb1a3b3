"""Slots iterate over sets of strings in one order, whatever seed the server was started with."""

import os
import subprocess
import sys

HASHES = """
from zswarm.ss.workers import parent

if __name__ == "__main__":
    parent.start_fork_server()
    with parent._context.Pool(2) as slots:
        print(set(slots.map(hash, ["door", "door", "door", "door"], chunksize=1)))
    print(hash("door"))
"""


def hashes(seed: str) -> list[str]:
    done = subprocess.run(
        [sys.executable, "-c", HASHES],
        env=os.environ | {"PYTHONHASHSEED": seed},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def test_strings_have_the_same_hashes_in_all_slots() -> None:
    (one, here), (other, there) = hashes("1"), hashes("2")
    assert one == other
    assert here != there, "those of the servers themselves differ"
