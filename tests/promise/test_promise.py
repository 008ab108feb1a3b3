"""The checker of the promise finds what breaks it."""

import os
import shutil
import sqlite3
import struct
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.promise.promise import Facts, check_prefix, check_run

ALL = 1_000_000
EXPERIMENT = """
name = "checked"
seed = 5
generations = 3
[problem]
simulator = "minisim"
trials = 3
[representation]
kind = "fully-meshed"
[optimizer]
kind = "nnga"
population = 12
[cluster]
servers = "local"
local_slots = 1
multicast = false
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a successful run."""
    folder = tmp_path_factory.mktemp("promise")
    (folder / "experiment.toml").write_text(EXPERIMENT)
    done = subprocess.run(
        [sys.executable, "-m", "zswarm.ot", "run", "experiment.toml"],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return folder / "runs" / "checked"


@contextmanager
def opened(folder: Path) -> Iterator[sqlite3.Connection]:
    database = sqlite3.connect(folder / "run.sqlite")
    try:
        yield database
        database.commit()
    finally:
        database.close()


def copy(run: Path, to: Path) -> Path:
    return Path(shutil.copytree(run, to / "copy"))


def test_a_correct_run_passes_the_check_of_every_trial(run: Path) -> None:
    facts = check_run(run, sample=ALL)
    assert facts.finished
    assert len(facts.told) == 3
    assert facts.again == len(facts.outcomes) > 0
    with opened(run) as database:
        assert (
            facts.history_hash
            == database.execute(
                "SELECT value FROM meta WHERE key = 'history_hash'"
            ).fetchone()[0]
        )


def test_the_sample_has_the_requested_size(run: Path) -> None:
    assert check_run(run, sample=7).again == 7


def test_a_continued_run_keeps_the_promise_as_a_part(run: Path, tmp_path: Path) -> None:
    folder = unfinished(run, tmp_path)
    part, whole = check_run(folder), check_run(run)
    assert not part.finished
    assert len(part.told) == 2
    assert len(part.outcomes) > len([key for key in part.outcomes if key[0] < 2]), (
        "some of the third generation are there"
    )
    check_prefix(part, whole)


def unfinished(run: Path, to: Path) -> Path:
    folder = copy(run, to)
    with opened(folder) as database:
        database.execute("DELETE FROM meta WHERE key = 'history_hash'")
        for table in ("generations", "candidates"):
            database.execute(f"DELETE FROM {table} WHERE generation = 2")  # noqa: S608  our own names
        database.execute("UPDATE optimizer SET generation = 1")
        first = database.execute(
            "SELECT id, metrics, count FROM outcomes WHERE generation = 2 ORDER BY id"
        ).fetchone()
        database.execute("DELETE FROM outcomes WHERE id > ?", first[:1])
        database.execute(
            "UPDATE outcomes SET count = 1, trials = substr(trials, 1, 4), fitness = "
            "substr(fitness, 1, 8), "
            "metrics = substr(metrics, 1, ?) WHERE id = ?",
            (len(first[1]) // first[2], first[0]),
        )
    return folder


def flipped(blob: bytes, bit: int = 0) -> bytes:
    """Return bytes with one bit changed."""
    return bytes([blob[0] ^ (1 << bit)]) + blob[1:]


def count_twice(database: sqlite3.Connection) -> None:
    columns = (
        "generation, asked, count, trials, fitness, metrics, faulted, server, seconds, at, "
        "doubtful, digest"
    )
    database.execute(
        f"INSERT INTO outcomes ({columns}) SELECT {columns} FROM outcomes "  # noqa: S608
        "WHERE id = (SELECT max(id) FROM outcomes)"
    )


def change_an_outcome(database: sqlite3.Connection) -> None:
    id_, fitness = database.execute(
        "SELECT id, fitness FROM outcomes WHERE generation = 1 LIMIT 1"
    ).fetchone()
    database.execute(
        "UPDATE outcomes SET fitness = ? WHERE id = ?", (flipped(fitness, 4), id_)
    )


def change_a_candidate(database: sqlite3.Connection) -> None:
    (fitness,) = database.execute(
        "SELECT fitness FROM candidates WHERE generation = 1 AND candidate = 3"
    ).fetchone()
    (changed,) = struct.unpack("<d", flipped(struct.pack("<d", fitness)))
    database.execute(
        "UPDATE candidates SET fitness = ? WHERE generation = 1 AND candidate = 3",
        (changed,),
    )


def change_a_genome(database: sqlite3.Connection) -> None:
    (genome,) = database.execute(
        "SELECT genome FROM candidates WHERE generation = 2 AND candidate = 0"
    ).fetchone()
    database.execute(
        "UPDATE candidates SET genome = ? WHERE generation = 2 AND candidate = 0",
        (flipped(genome),),
    )


def change_the_hash(database: sqlite3.Connection) -> None:
    (value,) = database.execute(
        "SELECT value FROM meta WHERE key = 'history_hash'"
    ).fetchone()
    database.execute(
        "UPDATE meta SET value = ? WHERE key = 'history_hash'", (value[::-1],)
    )


def change_a_metric(database: sqlite3.Connection) -> None:
    """Change a metric that nothing depends on: only a second evaluation finds it."""
    id_, metrics = database.execute(
        "SELECT id, metrics FROM outcomes WHERE generation = 0 LIMIT 1"
    ).fetchone()
    database.execute(
        "UPDATE outcomes SET metrics = ? WHERE id = ?", (flipped(metrics), id_)
    )


@pytest.mark.parametrize(
    ("tamper", "words"),
    [
        (count_twice, "is counted twice"),
        ("DELETE FROM outcomes WHERE id = 2", "were not counted"),
        (change_an_outcome, "but the sum of its trials is"),
        (change_a_candidate, "but the sum of its trials is"),
        (change_a_genome, "its genomes are not those that were evaluated"),
        (change_a_metric, "the outcome has other bits"),
        (change_the_hash, "the history hash is"),
        ("DELETE FROM generations WHERE generation = 1", "not contiguous"),
        (
            "DELETE FROM candidates WHERE generation = 1 AND candidate = 4",
            "candidate 5 comes after 3",
        ),
        ("UPDATE generations SET best = best + 1", "the best fitness so far is"),
        ("UPDATE optimizer SET generation = 0", "the optimizer's state is of"),
        ("UPDATE outcomes SET server = 'stranger-01234567' WHERE id = 3", "never joined"),
        ("UPDATE outcomes SET server = '' WHERE id = 3", "of no server, and no fault"),
        ("UPDATE meta SET value = -1 WHERE key = 'epoch'", "epoch -1"),
        (
            "INSERT INTO events VALUES (1.0, 0, 'requeued', '', '', -1, '', 0)",
            "event requeued",
        ),
        (
            "INSERT INTO events SELECT at, 2, 'server_wrong', server, '', 0, '', 0 FROM outcomes "
            "WHERE id = 3",
            "counted as if it had not",
        ),
    ],
    ids=lambda value: value.__name__ if callable(value) else "",
)
def test_a_manipulated_record_fails_the_check(
    run: Path,
    tmp_path: Path,
    tamper: str | Callable[[sqlite3.Connection], None],
    words: str,
) -> None:
    folder = copy(run, tmp_path)
    with opened(folder) as database:
        if callable(tamper):
            tamper(database)
        else:
            assert database.execute(tamper).rowcount > 0
    with pytest.raises(AssertionError, match=words):
        check_run(folder, sample=ALL)


def test_a_part_of_another_history_is_refused(run: Path, tmp_path: Path) -> None:
    part, whole = check_run(unfinished(run, tmp_path)), check_run(run)
    key = max(part.outcomes)
    assert key[0] == 2, "of the generation that is not finished"
    with pytest.raises(
        AssertionError, match=f"generation 2, trial {key[1]}: not the outcome"
    ):
        check_prefix(part._replace(outcomes={**part.outcomes, key: b"other"}), whole)
    with pytest.raises(AssertionError, match="its generations are not those"):
        check_prefix(Facts(False, ["0" * 32], {}, [], set(), 0, 0), whole)


def test_the_check_can_be_run_as_a_program(run: Path, tmp_path: Path) -> None:
    broken = copy(run, tmp_path)
    with opened(broken) as database:
        change_a_genome(database)
    program = [sys.executable, str(Path(__file__).parent / "promise.py"), "--sample", "3"]
    environment = os.environ | {"ZSWARM_PLAIN": "1"}
    good = subprocess.run(
        [*program, str(run)], capture_output=True, text=True, check=False, env=environment
    )
    both = subprocess.run(
        [*program, str(run), str(broken)],
        capture_output=True,
        text=True,
        check=False,
        env=environment,
    )
    assert (good.returncode, good.stdout.split()[0]) == (0, "kept")
    assert "3 evaluated again" in good.stdout
    assert both.returncode == 1
    assert both.stdout.splitlines()[1].startswith(f"BROKEN {broken}: generation 2")
