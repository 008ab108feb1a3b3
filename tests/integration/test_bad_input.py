"""Any bad input gives one clear line; the daemon keeps serving and nothing is lost."""

import contextlib
import os
import random
import signal
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import zenoh

from tests.integration import plugin
from tests.integration.programs import Optimizer, Server, free_port, query, wait_until
from tests.repository import REPOSITORY
from zswarm import session
from zswarm.ot import cli

NOBODY = ["--servers", "1", "--no-multicast"]  # no slots of this machine are started
SMALL = [
    "--set",
    "generations=2",
    "--set",
    "optimizer.population=10",
    "--set",
    "problem.trials=2",
]


def only_line(text: str) -> str:
    """Return the only line on stderr."""
    assert "Traceback" not in text
    lines = [line for line in text.splitlines() if line.startswith("zswarm-ot: ")]
    assert len(lines) == 1, text
    return lines[0]


@pytest.fixture
def rough(tmp_path: Path) -> str:
    folder = tmp_path / "site"
    folder.mkdir()
    return plugin.install(folder)


def evolve_rough(tmp_path: Path, rough: str, how: str, *options: str) -> Optimizer:
    file = plugin.experiment(tmp_path, how)
    arguments = ["run", str(file), "--json", "--servers", "local", *options]
    # It plays in Python, and little.
    return Optimizer(tmp_path, how, arguments, PYTHONPATH=rough, ZSWARM_PLAIN="1")


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["run", "nothing.toml"], 2, "no such file"),
        (["run", "emergency-exi"], 2, "did you mean 'emergency-exit'"),
        (["run", "damaged.toml"], 2, "not TOML"),
        (["run", "binary.toml"], 2, "not TOML"),
        (["run", "--set", "optimizer.populatoin=3"], 2, "did you mean 'population'"),
        (
            ["run", *NOBODY, "--set", "seed=3", "--set", "optimizer.populatoin=3"],
            2,
            "--set optimizer.populatoin=3: optimizer: unknown",
        ),
        (
            ["run", *NOBODY, "--repeat", "2", "--set", "optimizer.population=x"],
            2,
            "--set optimizer.population=x: optimizer: ",
        ),
        (["run", "--generations", "0"], 2, "--generations 0: generations: expected int"),
        (
            ["run", "--set", "optimizer.population=9", "--population", "1"],
            2,
            "--population 1: optimizer: population: expected int >= 2",
        ),
        (
            ["check", "--set", "problem.seeds=fix", "stadium"],
            2,
            "--set problem.seeds=fix: problem.seeds: expected fixed or",
        ),
        (["check", "damaged-run"], 2, "resume it with zswarm-ot resume"),
        (["evaluate", "nothing.toml"], 2, "an experiment has no champion"),
        (["evaluate", "damaged-run"], 2, "no champion.zsc in it"),
        (
            ["evaluate", "study"],
            2,
            "a folder of runs; expected one of them, such as study/a",
        ),
        (["list", "nofolder"], 2, "nofolder: no such folder"),
        (
            ["run", *NOBODY, "--set", "problem.simulator=stage"],
            2,
            "unknown simulator 'stage'",
        ),
        (
            ["run", *NOBODY, "--set", "representation.kind=lstm"],
            2,
            "unknown representation 'lstm'",
        ),
        (
            ["run", "emergency-exit", *NOBODY, "--set", "problem.settings.width=30"],
            2,
            "width must not exceed height",
        ),
        (
            ["run", *NOBODY, "--set", "problem.settings.agents=ten"],
            2,
            "agents: expected int, got str",
        ),
        (["run", "--servers", "many"], 2, "expected auto, local or a number"),
        (
            ["run", "--servers", "1", "--connect", "nonsense", "--no-multicast"],
            2,
            "expected endpoints such as",
        ),
        (
            ["run", *NOBODY, "--require", "gpu"],
            2,
            "cluster.require: expected requirements such as gpu=yes",
        ),
        (
            ["run", *NOBODY, "--require", "gpu=yes", "--require", "gpu=no"],
            2,
            "cluster.require: no server can meet gpu=yes and gpu=no",
        ),
        (
            ["run", *NOBODY, "--rank", "--cores"],
            2,
            "cluster.rank: expected the name of a label",
        ),
        (
            ["run", *NOBODY, "--max-slots", "-1"],
            2,
            "cluster: max_slots: expected int >= 0",
        ),
        (
            ["run", "--through-router", "--no-multicast"],
            2,
            "name the router in cluster.connect",
        ),
        (["servers", "--connect", "tcp/lab:http"], 2, "the port must be a number"),
        (["run", "--out", "damaged.toml/runs"], 2, "choose another place with --out"),
        (["resume", "."], 2, "no run"),
        (["resume", "damaged-run"], 2, "damaged"),
        (["evaluate", "damaged.zsc"], 2, "damaged, or no controller"),
        (["evaluate", "nothing"], 2, "cannot be read"),
    ],
)
def test_a_mistake_is_named_in_one_line(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    arguments: list[str],
    code: int,
    words: str,
) -> None:
    (tmp_path / "damaged.toml").write_text("name = ")
    (tmp_path / "binary.toml").write_bytes(bytes(range(256)))
    (tmp_path / "damaged.zsc").write_bytes(b"\x81\xa1")
    (tmp_path / "damaged-run").mkdir()
    for name in ("a", "b"):
        (tmp_path / "study" / name).mkdir(parents=True)
        (tmp_path / "study" / name / "champion.zsc").touch()
    example = REPOSITORY / "examples" / "emergency-exit.toml"
    (tmp_path / "damaged-run" / "experiment.toml").write_text(example.read_text())
    (tmp_path / "damaged-run" / "run.sqlite").write_bytes(
        b"SQLite format 3\0" + bytes(range(256)) * 20
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["zswarm-ot", *arguments])
    with pytest.raises(SystemExit) as ended:
        cli._run()  # ``main`` ends the process
    assert ended.value.code == code
    assert words in only_line(capfd.readouterr().err)
    assert not (tmp_path / "runs").exists()


def test_a_port_in_use_is_named(tmp_path: Path) -> None:
    first = Server(tmp_path, "first", capacity=1, ZSWARM_PLAIN="1").ready()
    second = Server(
        tmp_path, "second", port=int(first.endpoint.rsplit(":", 1)[1]), ZSWARM_PLAIN="1"
    )
    try:
        assert second.wait() == 2
        assert "the port is in use" in second.err.read_text()
        assert "Traceback" not in second.err.read_text()
    finally:
        first.close()
        second.close()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("capacity = 'two'", "capacity: expected int"),
        ("capcity = 2", "did you mean 'capacity'"),
        ("=", "daemon.toml"),
        ("slot_memory_mb = 100", "slot_memory_mb: expected 0 or at least 512, not 100"),
    ],
)
def test_a_damaged_daemon_configuration_exits_with_78(
    tmp_path: Path, text: str, words: str
) -> None:
    (tmp_path / "daemon.toml").write_text(text)
    server = Server(tmp_path, "ss", options=("--config", "daemon.toml"), ZSWARM_PLAIN="1")
    assert server.wait() == 78
    assert words in server.err.read_text()


@pytest.mark.parametrize(
    ("name", "words"),
    [("none.toml", "No such file or directory"), (".", "Is a directory")],
)
def test_a_daemon_configuration_that_cannot_be_read_is_named(
    tmp_path: Path, name: str, words: str
) -> None:
    server = Server(tmp_path, "ss", options=("--config", name), ZSWARM_PLAIN="1")
    assert server.wait() == 78
    assert server.err.read_text() == f"zswarm-ss: {name}: cannot be read: {words}\n"


@pytest.mark.faults
def test_a_server_whose_slots_have_too_little_memory_is_named(tmp_path: Path) -> None:
    server = Server(
        tmp_path, "ss", options=("--slot-memory", "512"), ZSWARM_PLAIN="1"
    ).ready()
    options = [
        "--no-multicast",
        "--connect",
        server.endpoint,
        "--set",
        "cluster.trial_memory_mb=1024",
    ]
    try:
        optimizer = Optimizer(tmp_path, "ot", ["run", "--servers", "1", *options])
        assert optimizer.wait() == 4
        assert (
            "is not used: a slot has 512 MB, the run asks for 1024"
            in optimizer.err.read_text()
        )
    finally:
        server.close()


def test_more_memory_than_this_machine_has_is_named(tmp_path: Path) -> None:
    options = ["--servers", "local", "--set", "cluster.trial_memory_mb=1000000000"]
    optimizer = Optimizer(tmp_path, "ot", ["run", *options], ZSWARM_PLAIN="1")
    assert optimizer.wait() == 1
    assert "the run asks for 1000000000" in only_line(optimizer.err.read_text())


def test_servers_that_do_not_match_are_named_with_the_reason(tmp_path: Path) -> None:
    server = Server(
        tmp_path, "ss", options=("--simulators", "minisim"), ZSWARM_PLAIN="1"
    ).ready()
    options = ["--no-multicast", "--connect", server.endpoint]
    try:
        optimizer = Optimizer(tmp_path, "ot", ["run", "--servers", "1", *options])
        assert optimizer.wait() == 4
        assert (
            "the server has no simulator 'emergency-exit'; it has minisim"
            in optimizer.err.read_text()
        )
        assert "0 of 1 matching servers" in only_line(optimizer.err.read_text())
        assert (
            optimizer.err.read_text()
            .splitlines()[-1]
            .startswith("stopped; nothing is lost.")
        ), "after the reason"
        seen = Optimizer(
            tmp_path,
            "seen",
            ["servers", "--wait", "1", "--for", "emergency-exit", "--json", *options],
        )
        assert seen.wait() == 0
        assert seen.lines()[0]["mismatch"].startswith("the server has no simulator")
    finally:
        server.close()


@pytest.mark.faults
def test_a_server_of_another_protocol_version_is_named(tmp_path: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    opened, _ = session.open_server([endpoint], session.Reach([], multicast=False))
    try:
        _token = opened.liveliness().declare_token(
            "zswarm/v9/default/ss/future-0123abcd/alive"
        )
        optimizer = Optimizer(
            tmp_path,
            "ot",
            ["run", "--servers", "1", "--no-multicast", "--connect", endpoint],
        )
        assert optimizer.wait() == 4
        assert (
            "future-0123abcd is not used: speaks version v9 of the protocol"
            in optimizer.err.read_text()
        )
    finally:
        session.close(opened)


@pytest.mark.programs
def test_a_simulator_that_raises_is_an_outcome_and_named(
    tmp_path: Path, rough: str
) -> None:
    optimizer = evolve_rough(tmp_path, rough, "raises")
    optimizer.done()
    text = optimizer.err.read_text()
    assert "ZeroDivisionError: the gripper broke" in text
    assert "Traceback" not in text


@pytest.mark.programs
@pytest.mark.parametrize(
    ("how", "words"),
    [
        ("hangs", "one trial took longer than 1 s"),
        ("exits", "ended with code 7"),
        ("segfault", "was killed by signal 11 (SIGSEGV)"),
        (
            "hoards",
            "memory: simulator rough: it needs more than the 512 MB of cluster.trial_memory_mb: "
            "raise that, if servers have more",
        ),
    ],
)
def test_a_simulator_that_ends_its_process_pauses_the_run_and_names_the_cause(
    tmp_path: Path, rough: str, how: str, words: str
) -> None:
    optimizer = evolve_rough(tmp_path, rough, how)
    assert optimizer.wait() == 1
    assert words in only_line(optimizer.err.read_text())
    assert "zswarm-ot resume runs/rough" in optimizer.err.read_text()


@pytest.mark.programs
@pytest.mark.parametrize(
    "how",
    [
        "exits",
        *(pytest.param(how, marks=pytest.mark.faults) for how in ("segfault", "hoards")),
    ],
)
def test_quarantine_counts_the_guilty_trials_and_no_other(
    tmp_path: Path, rough: str, how: str
) -> None:
    """The second trial of each of four candidates; the others of their batches are evaluated."""
    small = [
        "--set",
        "cluster.on_fault=quarantine",
        "--set",
        "generations=1",
        "--set",
        "optimizer.population=4",
    ]
    assert evolve_rough(tmp_path, rough, how, *small).done()["faulted"] == 4
    guilty, innocent = [], []
    for trials, fitness, faulted in query(
        tmp_path / "runs" / "rough", "SELECT trials, fitness, faulted FROM outcomes"
    ):
        rows = list(
            zip(np.frombuffer(trials, "<u4"), np.frombuffer(fitness, "<f8"), strict=True)
        )
        (guilty if faulted else innocent).extend(rows)
    assert sorted(trial for trial, _ in guilty) == list(range(1, 12, 3))
    assert all(np.isnan(value) for _, value in guilty)
    assert sorted(trial for trial, _ in innocent) == [
        trial for trial in range(12) if trial % 3 != 1
    ]
    assert not any(np.isnan(value) for _, value in innocent)


@pytest.mark.faults
def test_a_simulator_that_ends_its_process_once_or_leaks_does_not_change_the_history(
    tmp_path: Path, rough: str
) -> None:
    """72 trials leak 20 MB each, where 512 are allowed: no trial is blamed."""
    hashes = set()
    for how in ("fine", "exits-once", "segfault-once", "leaks"):
        done = evolve_rough(tmp_path, rough, how).done()
        hashes.add(done["history_hash"])
        assert (tmp_path / "marker").exists() == (how in ("exits-once", "segfault-once"))
        (tmp_path / "marker").unlink(missing_ok=True)
    assert len(hashes) == 1
    assert done["requeued"] == 0
    assert query(
        tmp_path / "runs" / "rough-4", "SELECT count(*) FROM events WHERE event = 'fault'"
    ) == [(0,)]


@pytest.mark.programs
def test_a_simulator_that_needs_too_much_memory_from_the_start_is_named(
    tmp_path: Path, rough: str
) -> None:
    optimizer = evolve_rough(tmp_path, rough, "too-large")
    assert optimizer.wait() == 1
    assert "it needs more than the 512 MB of cluster.trial_memory_mb" in only_line(
        optimizer.err.read_text()
    )


@pytest.mark.programs
def test_a_simulator_that_cannot_be_set_up_is_named(tmp_path: Path, rough: str) -> None:
    optimizer = evolve_rough(tmp_path, rough, "refuses")
    assert optimizer.wait() == 2
    assert "no licence found" in only_line(optimizer.err.read_text())


@pytest.mark.faults
def test_a_plug_in_that_cannot_be_imported_is_named_and_affects_no_other(
    tmp_path: Path, rough: str
) -> None:
    broken = Optimizer(
        tmp_path, "broken", ["run", "--set", "problem.simulator=broken"], PYTHONPATH=rough
    )
    assert broken.wait() == 2
    assert "simulator 'broken' cannot be imported: ModuleNotFoundError" in only_line(
        broken.err.read_text()
    )
    evolve_rough(tmp_path, rough, "fine").done()


@pytest.mark.faults
def test_a_daemon_survives_bad_simulators_and_serves_the_next_run(
    tmp_path: Path, rough: str
) -> None:
    server = Server(tmp_path, "ss", PYTHONPATH=rough).ready()
    options = ["--json", "--no-multicast", "--servers", "1", "--connect", server.endpoint]
    try:
        for how in ("exits", "hangs"):
            bad = Optimizer(
                tmp_path,
                how,
                ["run", str(plugin.experiment(tmp_path, how)), *options],
                PYTHONPATH=rough,
            )
            assert bad.wait() == 1
        Optimizer(tmp_path, "good", ["run", *SMALL, *options]).done()
    finally:
        server.close()


@pytest.mark.faults
def test_a_daemon_serves_although_slots_repeatedly_die_at_their_start(
    tmp_path: Path,
) -> None:
    """Processes that lack memory are restarted with growing delays until they start."""
    server = Server(tmp_path, "ss", capacity=1).ready()
    options = ["--json", "--no-multicast", "--servers", "1", "--connect", server.endpoint]

    def kill_slots() -> bool:
        for slot in slots_of(server.process.pid):
            with contextlib.suppress(ProcessLookupError):
                os.kill(slot, signal.SIGKILL)
        return len(server.events("slot_pauses")) >= 4

    try:
        wait_until(kill_slots, "four pauses")
        pauses = [event["seconds"] for event in server.events("slot_pauses")]
        assert sorted(pauses) == pauses
        assert (
            server.events("slot_pauses")[0]["reason"]
            == "was killed by signal 9 (SIGKILL; the machine may have run out of memory)"
        )
        Optimizer(tmp_path, "next", ["run", *SMALL, *options]).done()
        assert server.process.poll() is None
    finally:
        server.close()


def slots_of(server: int) -> list[int]:
    """Return the slots' processes: children of the server's fork server."""

    def children(of: int) -> list[int]:
        return [
            int(child)
            for child in Path(f"/proc/{of}/task/{of}/children").read_text().split()
        ]

    return [slot for child in children(server) for slot in children(child)]


@pytest.mark.faults
def test_a_daemon_survives_random_bytes_on_every_key(tmp_path: Path) -> None:
    server = Server(tmp_path, "ss").ready()
    name = server.events("server_ready")[0]["server"]
    draw = random.Random(7)
    verbs = [
        "offer",
        *(
            f"ot/someone/some-run/{verb}"
            for verb in (
                "reserve",
                "renew",
                "evaluate",
                "cancel",
                "release",
                "x",
                "reserve/y",
            )
        ),
    ]
    answers = 0
    opened = session.open_optimizer(session.Reach([server.endpoint], multicast=False))
    try:
        wait_until(lambda: list(opened.info.peers_zid()), "the session is connected")
        tokens = [
            opened.liveliness().declare_token(f"zswarm/v1/default/ot/{user}/{user}/alive")
            for user in ("someone", "UPPER", "a_b")
        ]
        end = time.monotonic() + 30.0
        while time.monotonic() < end:
            key = f"zswarm/v1/default/ss/{name}/{draw.choice(verbs)}"
            body = draw.randbytes(draw.choice([0, 1, 16, 300, 20_000]))
            if draw.random() < 0.3:
                opened.put(key, body)
                continue
            answers += sum(
                reply.ok is not None
                for reply in opened.get(
                    key, payload=body, target=zenoh.QueryTarget.ALL, timeout=5.0
                )
            )
        assert len(tokens) == 3
    finally:
        session.close(opened)
    try:
        assert answers > 100, "malformed requests are answered with a refusal"
        assert 1 < len(server.events("malformed")) < 40, (
            "they are logged, and do not flood the log"
        )
        options = [
            "--json",
            "--no-multicast",
            "--servers",
            "1",
            "--connect",
            server.endpoint,
        ]
        Optimizer(tmp_path, "next", ["run", *SMALL, *options]).done()
        assert server.process.poll() is None
    finally:
        server.close()
