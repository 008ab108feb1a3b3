"""A run survives disks that fill up, fail, turn read-only or lose their last writes."""

import contextlib
import random
import resource
import shutil
import signal
import sqlite3
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.integration import asleep, evacuation
from tests.integration.asleep import HISTORY
from tests.integration.evacuation import ASSESSED, COUNTED, TRIALS
from tests.integration.programs import Optimizer, Server, query, wait_until
from tests.promise.promise import check_prefix, check_run
from zswarm.ot.record.writer import Record

pytestmark = [pytest.mark.faults, pytest.mark.usefixtures("sleeping")]

CLUSTER = """
[cluster]
servers = "local"
local_slots = 2
multicast = false
"""
ROWS = "SELECT id, generation, trials, fitness, server, at FROM outcomes ORDER BY id"
STUDY = """
[study]
repeat = 2
at_once = 2
"""
KILLS = 15
INTERRUPTED = {"run": 5, "study": 2}  # times
SNAPSHOTS = 8
SHORT, REPORTED = 400, 4  # generations of some milliseconds, and kills at their reports

Mount = Callable[..., Path]
STARTED: list[Optimizer] = []


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the experiment's run on a good disk."""
    folder = tmp_path_factory.mktemp("undisturbed")
    run(folder).done()
    return folder / "runs" / "on-disk"


@pytest.fixture
def mount(tmp_path: Path) -> Iterator[Mount]:
    """Mount a file system below the test's folder; unmount it at the end."""
    mounted: list[Path] = []

    def mounting(name: str, *how: str) -> Path:
        place = tmp_path / name
        place.mkdir(exist_ok=True)
        done = subprocess.run(
            ["mount", *how, str(place)], capture_output=True, text=True, check=False
        )
        if done.returncode:
            pytest.skip(f"mounting is not permitted here: {done.stderr.strip()}")
        mounted.append(place)
        return place

    yield mounting
    for place in mounted:
        subprocess.run(["umount", "--lazy", str(place)], capture_output=True, check=False)


@pytest.fixture(autouse=True)
def ended() -> Iterator[None]:
    """Check that no program outlives its test."""
    yield
    while STARTED:
        STARTED.pop().close()


def run(folder: Path, *options: str, name: str = "run") -> Optimizer:
    return start(
        folder,
        name,
        "run",
        asleep.write(folder, "on-disk", CLUSTER),
        "--json",
        *options,
    )


def resume(folder: Path, at: Path, *options: str, name: str = "resumed") -> Optimizer:
    return start(folder, name, "resume", str(at), "--json", *options)


def start(folder: Path, name: str, *arguments: str) -> Optimizer:
    STARTED.append(Optimizer(folder, name, list(arguments)))
    return STARTED[-1]


def counted(at: Path) -> int:
    rows = query(at, COUNTED)
    return int(rows[0][0]) if rows else 0


def said(optimizer: Optimizer, words: str) -> int:
    """Return lines on stderr with these words."""
    return sum(words in line for line in optimizer.err.read_text().splitlines())


def fill(folder: Path) -> Path:
    """Write a file that takes all free space."""
    ballast = folder / "ballast"
    with ballast.open("ab", buffering=0) as file:
        for size in (65_536, 4096, 1):
            try:
                while True:
                    file.write(bytes(size))
            except OSError:
                continue
    return ballast


def wait_until_said(optimizer: Optimizer, words: str, times: int = 1) -> None:
    wait_until(
        lambda: said(optimizer, words) >= times or optimizer.process.poll() is not None,
        f"{optimizer.err} says {words!r} {times} times",
    )
    assert said(optimizer, words) == times, optimizer.err.read_text()


def tmpfs(mount: Mount) -> Path:
    return mount("disk", "-t", "tmpfs", "-o", "size=16m", "tmpfs")


# ---- full


def test_a_run_waits_for_disk_space_and_continues(tmp_path: Path, mount: Mount) -> None:
    """Twice; nothing is evaluated again, and the server keeps the lease."""
    disk = tmpfs(mount)
    server = Server(tmp_path, "ss")
    optimizer = run(
        tmp_path, "--out", "disk", "--servers", "1", f"--connect={server.endpoint}"
    )
    at = disk / "on-disk"
    try:
        for episode in (1, 2):
            before = counted(at)
            wait_until(
                lambda before=before: counted(at) > before + 100,
                "some trials are counted",
            )
            ballast = fill(disk)
            wait_until_said(
                optimizer,
                "the disk of disk/on-disk is full: waiting for room; nothing is lost",
                episode,
            )
            stuck = counted(at)
            ballast.unlink()
            wait_until_said(
                optimizer,
                "the disk of disk/on-disk can be written again: the run continues",
                episode,
            )
            wait_until(lambda stuck=stuck: counted(at) > stuck, "what waited is recorded")
        done = optimizer.done()
        leases = server.events("lease_granted")
    finally:
        server.close()
    facts = check_run(at)
    assert done["history_hash"] == facts.history_hash == HISTORY
    assert (done["requeued"], len(leases)) == (0, 1), (
        "the run lost its server while it waited"
    )
    assert query(at, "SELECT count(*) FROM events WHERE event = 'disk_waited'") == [(2,)]
    assert said(optimizer, "is full") == 2, "one line for each time"


def test_a_run_that_waits_for_disk_space_can_be_stopped_and_resumed(
    tmp_path: Path, mount: Mount
) -> None:
    disk = tmpfs(mount)
    optimizer = run(tmp_path, "--out", "disk")
    at = disk / "on-disk"
    wait_until(lambda: counted(at) > 100, "some trials are counted")
    ballast = fill(disk)
    wait_until_said(optimizer, "waiting for room")
    optimizer.kill(signal.SIGINT)
    assert optimizer.wait() == 130
    assert said(optimizer, "Resume with: zswarm-ot resume disk/on-disk") == 1
    assert said(optimizer, "Traceback") == 0
    for log in ("as it was left", "carried over, so that even its index needs room"):
        if log != "as it was left":
            ballast.unlink()
            with contextlib.closing(sqlite3.connect(at / "run.sqlite")) as database:
                database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        fill(disk)  # closing the record may have made room
        resumed = resume(tmp_path, at, name="too-early")
        wait_until(
            lambda resumed=resumed: (
                resumed.process.poll() is not None or said(resumed, "waiting for room")
            ),
            "it is refused, or waits where the log has some room left",
        )
        if waits := said(resumed, "waiting for room"):
            resumed.kill(signal.SIGINT)
        assert resumed.wait() == (130 if waits else 2), resumed.err.read_text()
        assert (
            waits
            or resumed.err.read_text()
            == f"zswarm-ot: {at}: cannot be written: No space left on device\n"
        ), log
    another = run(tmp_path, "--out", "disk", name="another")
    assert another.wait() == 2, another.err.read_text()
    assert said(another, "No space left on device; choose another place with --out") == 1
    assert [path.name for path in disk.iterdir() if path.is_dir()] == ["on-disk"], (
        "a folder was left behind"
    )
    ballast.unlink()
    rows = query(at, ROWS)
    assert resume(tmp_path, at).done()["history_hash"] == HISTORY
    assert query(at, ROWS)[: len(rows)] == rows
    check_run(at)


@pytest.mark.parametrize("what", ["run", "study"])
def test_ctrl_c_ends_a_run_that_waits_for_disk_space(
    tmp_path: Path, mount: Mount, what: str
) -> None:
    """At whatever it is then: many times, a bit later each time."""
    disk = tmpfs(mount)
    if what == "study":
        file = asleep.write(tmp_path, "on-disk", CLUSTER + STUDY)
        start(tmp_path, "run", "run", file, "--out", "disk", "--json")
    else:
        run(tmp_path, "--out", "disk")
    folder = disk / "on-disk"
    at = folder / "seed-3" if what == "study" else folder
    for number in range(INTERRUPTED[what]):
        optimizer = STARTED[-1]
        before = counted(at)
        wait_until(lambda before=before: counted(at) > before, "some trials are counted")
        ballast = fill(disk)
        wait_until(lambda o=optimizer: said(o, "waiting for room"), "it waits for room")
        time.sleep(number * 0.13)
        optimizer.kill(signal.SIGINT)
        assert optimizer.wait() == 130, optimizer.err.read_text()
        ballast.unlink()
        assert said(optimizer, "Traceback") == 0
        assert said(optimizer, "Resume with: zswarm-ot resume disk/on-disk") == 1
        resume(tmp_path, Path("disk", "on-disk"), name=f"resumed-{number}")
    done = STARTED[-1].done()
    if what == "study":
        assert done["finished"] == 2
    else:
        assert done["history_hash"] == HISTORY
    check_run(at)


def test_a_run_in_the_background_that_waits_for_disk_space_ends_by_sigterm(
    tmp_path: Path, mount: Mount
) -> None:
    """What a script starts with & has SIGINT ignored, as a shell arranges it."""
    disk = tmpfs(mount)
    file = asleep.write(tmp_path, "on-disk", CLUSTER)
    background = ["env", "--ignore-signal=INT"]
    arguments = ["run", file, "--out", "disk", "--json"]
    STARTED.append(optimizer := Optimizer(tmp_path, "run", arguments, background))
    at = disk / "on-disk"
    wait_until(lambda: counted(at) > 100, "some trials are counted")
    ballast = fill(disk)
    wait_until_said(optimizer, "waiting for room")
    optimizer.kill(signal.SIGINT)
    optimizer.kill(signal.SIGTERM)
    assert optimizer.wait() == 143
    assert said(optimizer, "Resume with: zswarm-ot resume disk/on-disk") == 1
    ballast.unlink()
    assert resume(tmp_path, at).done()["history_hash"] == HISTORY


# ---- failing


def test_a_run_survives_writes_that_fail(tmp_path: Path) -> None:
    """A limit on file sizes, which SQLite reports as an I/O error, is set and lifted again."""
    optimizer = run(tmp_path)
    at, small = tmp_path / "runs" / "on-disk", 30_000
    log = at / "run.sqlite-wal"
    wait_until(
        lambda: log.is_file() and log.stat().st_size > 2 * small,
        "the log is larger than files may get",
    )
    _, most = resource.prlimit(optimizer.process.pid, resource.RLIMIT_FSIZE)
    resource.prlimit(optimizer.process.pid, resource.RLIMIT_FSIZE, (small, most))
    wait_until_said(
        optimizer,
        "the disk of runs/on-disk cannot be written: trying again; nothing is lost",
    )
    resource.prlimit(optimizer.process.pid, resource.RLIMIT_FSIZE, (most, most))
    wait_until_said(optimizer, "can be written again: the run continues")
    assert optimizer.done()["history_hash"] == HISTORY
    check_run(at)


def test_a_disk_that_becomes_read_only_loses_nothing_recorded(
    tmp_path: Path, mount: Mount
) -> None:
    """ext4 remounts read-only when the device fails; unrecorded trials are evaluated again."""
    image = tmp_path / "image"
    with image.open("wb") as file:
        file.truncate(16 << 20)
    if shutil.which("mkfs.ext4") is None:
        pytest.skip("mkfs.ext4 is not here: install e2fsprogs")
    subprocess.run(["mkfs.ext4", "-q", str(image)], check=True, capture_output=True)
    disk = mount("disk", "-o", "loop", str(image))
    optimizer = run(tmp_path, "--out", "disk")
    at = disk / "on-disk"
    wait_until(lambda: counted(at) > 100, "some trials are counted")
    subprocess.run(
        ["mount", "-o", "remount,abort", str(disk)], check=True, capture_output=True
    )
    # Newer kernels do not call it read-only.
    wait_until_said(optimizer, "the disk of disk/on-disk ")
    rows = query(at, ROWS)
    optimizer.kill(signal.SIGINT)
    assert optimizer.wait() == 130
    assert said(optimizer, "trials again") == 1
    assert said(optimizer, "Resume with: zswarm-ot resume disk/on-disk") == 1
    subprocess.run(["umount", str(disk)], check=True)
    # Programs in other mount namespaces may hold the broken one.
    repaired = shutil.copy(image, tmp_path / "repaired")
    assert subprocess.run(
        ["e2fsck", "-fy", str(repaired)], capture_output=True
    ).returncode in (
        0,
        1,
    ), "it is repaired"
    mount("disk", "-o", "loop", str(repaired))
    assert len(rows) > 0
    assert query(at, ROWS)[: len(rows)] == rows, "recorded outcomes are gone"
    assert resume(tmp_path, at).done()["history_hash"] == HISTORY
    check_run(at)


# ---- read-only


def test_a_read_only_folder_is_read_and_not_written(
    tmp_path: Path, undisturbed: Path, mount: Mount
) -> None:
    """A finished run, a killed one with its WAL, and one with its WAL but no index."""
    disk = tmpfs(mount)
    shutil.copytree(undisturbed, disk / "finished")
    killed = run(tmp_path, "--out", "disk")
    wait_until(
        lambda: query(disk / "on-disk", "SELECT 1 FROM generations"),
        "a generation is finished",
    )
    killed.kill()
    killed.wait()
    shutil.copytree(
        disk / "on-disk", disk / "copied", ignore=shutil.ignore_patterns("*-shm")
    )
    generations = len(query(disk / "on-disk", "SELECT 1 FROM generations"))
    subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)

    listed = start(tmp_path, "list", "list", "disk", "--json")
    assert listed.wait() == 0, listed.err.read_text()
    rows = {Path(row["run"]).name: row for row in listed.lines()[0]["runs"]}
    assert rows["finished"]["history_hash"] == HISTORY
    assert [
        rows[name].get("generations") for name in ("on-disk", "copied", "finished")
    ] == [
        generations,
        generations,
        4,
    ], rows
    evaluated = start(
        tmp_path, "evaluate", "evaluate", "disk/finished", "--trials", "2", "--json"
    )
    assert evaluated.wait() == 0, evaluated.err.read_text()
    assert evaluated.lines()[0]["trials"] == 2

    for name, arguments, words in (
        (
            "run",
            ["run", "experiment.toml", "--out", "disk"],
            "cannot be made: Read-only file system; choose another place",
        ),
        (
            "resume",
            ["resume", "disk/on-disk"],
            "disk/on-disk: cannot be written: Read-only file system",
        ),
    ):
        refused = start(tmp_path, f"refused-{name}", *arguments)
        assert refused.wait() == 2
        lines = refused.err.read_text().splitlines()
        assert len(lines) == 1, lines
        assert words in lines[0]


# ---- killed


def wait_for_a_moment(optimizer: Optimizer, at: Path, until: int, seconds: float) -> None:
    """Wait until more trials are counted or a time is over."""
    end = time.monotonic() + seconds
    wait_until(
        lambda: (
            counted(at) > until
            or time.monotonic() > end
            or optimizer.process.poll() is not None
        ),
        "a moment to kill at",
    )


def test_a_repeatedly_killed_run_has_the_same_result(tmp_path: Path) -> None:
    """The seeded random moments range from before the folder exists to the last generation."""
    draw, at = random.Random(11), tmp_path / "runs" / "on-disk"
    total = TRIALS + ASSESSED
    server = Server(tmp_path, "ss").ready()
    remote = ["--servers", "1", f"--connect={server.endpoint}"]
    kept: list[tuple[object, ...]] = []
    try:
        for kill in range(KILLS):
            first = not (at / "run.sqlite").exists()
            options = (*remote, "--out", "runs")
            optimizer = (
                run(tmp_path, *options, name=f"{kill}")
                if first
                else resume(tmp_path, at, *remote, name=f"{kill}")
            )
            # A folder that is not there yet is no run, and the next one gets a name of its own.
            if first:
                shutil.rmtree(at, ignore_errors=True)
            until = min(total - 1, len(kept) and counted(at)) + draw.randrange(
                total // KILLS
            )
            wait_for_a_moment(optimizer, at, until, draw.uniform(0.2, 2.5))
            optimizer.kill()
            assert optimizer.wait() in (0, -signal.SIGKILL), optimizer.err.read_text()
            rows = query(at, ROWS)
            assert rows[: len(kept)] == kept, "what was recorded changed or is gone"
            kept = rows
        assert 0 < counted(at) <= total
        done = resume(tmp_path, at, *remote).done()
    finally:
        server.close()
    facts = check_run(at)
    assert query(at, ROWS)[: len(kept)] == kept
    assert counted(at) == total, "a recorded trial was evaluated again"
    assert done["history_hash"] == facts.history_hash == HISTORY
    assert query(at, "SELECT value > 3 FROM meta WHERE key = 'epoch'") == [(1,)]


def test_a_run_killed_at_the_reports_of_short_generations_has_the_same_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What was reported a moment before may be lost; what is recorded is a beginning of the run."""
    monkeypatch.delenv("ZSWARM_PLAIN")
    more = f"{CLUSTER}[assessment]\nbudget = 0.0\n"
    file = Path(evacuation.write(tmp_path, "on-disk", steps=10, more=more))
    short = file.read_text().replace("generations = 4", f"generations = {SHORT}")
    file.write_text(short.replace("trials = 20", "trials = 1"))
    undisturbed = start(tmp_path, "whole", "run", str(file), "--out", "whole", "--json")
    history = undisturbed.done()["history_hash"]
    whole, at = check_run(tmp_path / "whole" / "on-disk"), tmp_path / "runs" / "on-disk"
    recorded, lost = 0, 0
    optimizer = start(tmp_path, "0", "run", str(file), "--json")
    for kill in range(1, REPORTED + 1):
        until = recorded + SHORT // (REPORTED + 1)

        def reported(optimizer: Optimizer = optimizer) -> int:
            found = [line.get("generation", -1) for line in optimizer.lines()]
            return max(found, default=-1) + 1

        wait_until(lambda reported=reported, until=until: reported() >= until, "reports")
        optimizer.kill()
        assert optimizer.wait() == -signal.SIGKILL, optimizer.err.read_text()
        facts = check_run(at, sample=3)
        check_prefix(facts, whole)
        assert len(facts.told) >= recorded, "what was recorded is gone"
        recorded = len(facts.told)
        lost += reported() - recorded
        optimizer = resume(tmp_path, at, name=str(kill))
    assert optimizer.done()["history_hash"] == history
    assert check_run(at).told == whole.told
    assert lost < SHORT // 2, "reported, and not recorded for long"


def test_a_log_cut_anywhere_is_the_beginning_of_the_run(tmp_path: Path) -> None:
    """Copies taken during writing, with the WAL cut at a random length, as after a power cut."""
    draw, at = random.Random(12), tmp_path / "runs" / "on-disk"
    optimizer = run(tmp_path)
    copies: list[Path] = []
    size = 0
    for number in range(SNAPSHOTS):
        wait_until(
            lambda number=number: counted(at) > number * 250, "more trials are counted"
        )
        optimizer.kill(signal.SIGSTOP)
        content = {
            name: (at / name).read_bytes()
            for name in ("experiment.toml", "run.sqlite", "run.sqlite-wal")
        }
        optimizer.kill(signal.SIGCONT)
        size = size or len(content["run.sqlite"])
        if len(content["run.sqlite"]) != size:
            # The log was carried over: no power cut takes away from it what is in the database
            break
        for cut in (
            len(content["run.sqlite-wal"]),
            *(draw.randrange(len(content["run.sqlite-wal"])) for _ in range(3)),
        ):
            copy = tmp_path / "copies" / str(len(copies))
            copy.mkdir(parents=True)
            for name, held in content.items():
                (copy / name).write_bytes(
                    held[:cut] if name == "run.sqlite-wal" else held
                )
            copies.append(copy)
    done = optimizer.done()
    whole = check_run(at)
    assert done["history_hash"] == whole.history_hash == HISTORY
    assert len(copies) >= 4 * 3
    lengths = []
    for copy in copies:
        facts = check_run(copy, sample=3)
        check_prefix(facts, whole)
        assert facts.rows == whole.rows[: len(facts.rows)]
        lengths.append(len(facts.rows))
        Record.open(copy)[0].close()
    assert len(set(lengths)) > len(copies) // 4, "the cuts made no difference"
    longest = copies[lengths.index(max(lengths))]
    assert resume(tmp_path, longest).done()["history_hash"] == whole.history_hash
    check_run(longest)
