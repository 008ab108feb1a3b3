"""A machine that computes wrong bits is found out, named, and does not change the history."""

from pathlib import Path

import pytest

from tests.integration import plugin
from tests.integration.programs import Optimizer, Program, Server, query
from tests.lab_keys import issued, of, unpacked
from tests.repository import REPOSITORY

pytestmark = pytest.mark.faults


@pytest.fixture(autouse=True)
def uncompiled(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have programs compile nothing: to load numba takes longer than these trials."""
    monkeypatch.setenv("ZSWARM_PLAIN", "1")


@pytest.fixture
def path(tmp_path: Path) -> str:
    folder = tmp_path / "site"
    folder.mkdir()
    return plugin.install(folder)


def broken_server(
    folder: Path, name: str, path: str, wrong: str, keys: str = ""
) -> Server:
    """Start a server of another machine: that is another certificate, or another address."""
    if keys:
        return Server(
            folder,
            name,
            capacity=1,
            protocol="tls",
            options=("--name", "broken"),
            PYTHONPATH=path,
            ROUGH_WRONG=wrong,
            ZSWARM_KEYS=keys,
        )
    return Server(
        folder,
        name,
        capacity=1,
        address="127.0.0.2",
        PYTHONPATH=path,
        ROUGH_WRONG=wrong,
    )


@pytest.mark.parametrize(
    ("wrong", "options"), [("trials", ["--set", "cluster.verify=1.0"]), ("probe", [])]
)
def test_a_server_that_computes_wrong_is_named_and_the_history_is_the_same(
    tmp_path: Path, path: str, wrong: str, options: list[str]
) -> None:
    file = plugin.experiment(tmp_path, "slow")
    right = Optimizer(
        tmp_path,
        "alone",
        ["run", str(file), "--json", "--servers", "local"],
        PYTHONPATH=path,
    ).done()
    servers = [
        Server(tmp_path, "sound", capacity=1, PYTHONPATH=path).ready(),
        broken_server(tmp_path, "broken", path, wrong).ready(),
    ]
    remote = [
        "--servers",
        "2",
        "--no-multicast",
        *(f"--connect={server.endpoint}" for server in servers),
    ]
    optimizer = Optimizer(
        tmp_path,
        "ot",
        ["run", str(file), "--json", "--out", "two", *remote, *options],
        PYTHONPATH=path,
    )
    try:
        done = optimizer.done()
    finally:
        for program in (*servers, optimizer):
            program.close()
    run = tmp_path / "two" / "rough"
    assert done["history_hash"] == right["history_hash"]
    # An earlier generation may have ended before the servers' probes were compared.
    trusted = "SELECT coalesce(sum(count), 0) FROM outcomes WHERE server LIKE 'broken-%'"
    assert query(run, f"{trusted} AND NOT doubtful") == [(0,)]
    assert query(run, trusted) == [(done["doubtful"],)]
    ((named,),) = query(
        run, "SELECT DISTINCT server FROM events WHERE event = 'server_wrong'"
    )
    assert named.startswith("broken-")
    assert f"{named} is banned" in optimizer.err.read_text()
    probe = "SELECT value FROM meta WHERE key = 'probe'"
    (recorded,), (sound,) = (
        query(run, probe)[0],
        query(tmp_path / "runs" / "rough", probe)[0],
    )
    assert recorded[:8] == sound[:8], "the probe of the wrong server is kept"
    checker = Program(
        tmp_path,
        "promise",
        [str(REPOSITORY / "tests" / "promise" / "promise.py"), str(run)],
        PYTHONPATH=path,
    )
    assert checker.wait() == 0, checker.err.read_text()


@pytest.mark.parametrize(
    "machine", ["127.0.0.2", pytest.param("broken", marks=pytest.mark.thorough)]
)
def test_no_wrong_outcome_of_a_machine_with_five_servers_stays_nor_after_a_resume(
    tmp_path: Path, path: str, machine: str
) -> None:
    """All its answers are wrong, and one trial in a hundred is verified."""
    file = plugin.experiment(tmp_path, "slow")
    arguments = ["run", str(file), "--json"]
    longer = ["--set", "generations=5"]
    right = Optimizer(
        tmp_path, "alone", [*arguments, *longer, "--servers", "local"], PYTHONPATH=path
    ).done()
    programs: list[Program] = []
    keys = {"sound": "", "broken": "", "alice": ""}
    if machine == "broken":
        holders = [of("ss", "sound"), of("ss", "broken"), of("ot", "alice")]
        contents = issued(tmp_path / "authority", *holders)
        for name, content in zip(keys, contents, strict=True):
            keys[name] = str(unpacked(tmp_path / f"keys-of-{name}", content))
    uses = {name: {"ZSWARM_KEYS": at} if at else {} for name, at in keys.items()}
    protocol = "tls" if keys["sound"] else "tcp"

    def start(server: Server) -> Server:
        programs.append(server)
        return server

    def evolve(
        name: str, command: list[str], servers: list[Server], matching: int = 2
    ) -> Optimizer:
        for server in servers:
            server.ready()
        ends = [f"--connect={server.endpoint}" for server in servers]
        at = ["--servers", str(matching), "--no-multicast", *ends]
        optimizer = Optimizer(
            tmp_path, name, [*command, *at], PYTHONPATH=path, **uses["alice"]
        )
        programs.append(optimizer)
        return optimizer

    run = tmp_path / "two" / "rough"
    try:
        sound = start(
            Server(
                tmp_path,
                "sound",
                capacity=1,
                protocol=protocol,
                PYTHONPATH=path,
                **uses["sound"],
            )
        )
        broken = [
            start(
                broken_server(
                    tmp_path, f"broken-{number}", path, "trials", keys["broken"]
                )
            )
            for number in range(5)
        ]
        verify = ["--set", "cluster.verify=0.01", "--out", "two"]
        first = evolve("first", [*arguments, *verify], [sound, *broken])
        assert first.done()["doubtful"] == 0
        assert "is banned: its outcome of trial" in first.err.read_text()
        (machines,) = query(
            run, "SELECT DISTINCT machine FROM events WHERE event = 'server_wrong'"
        )
        assert machines == (machine,)
        for server in broken:
            server.close()
        settings = run / "experiment.toml"
        text = settings.read_text()
        assert "generations = 3\n" in text
        settings.write_text(text.replace("generations = 3\n", "generations = 5\n"))
        again = start(broken_server(tmp_path, "innocent", path, "trials", keys["broken"]))
        resume = ["resume", str(run), "--json"]
        waits = evolve("waits", resume, [sound, again])
        assert waits.wait() == 4, "too few servers"
        said = waits.err.read_text()
        assert said.count(f"is not used: its machine, {machine}, computed wrong") == 1
        resumed = evolve("resumed", resume, [sound, again], matching=1)
        assert resumed.done()["history_hash"] == right["history_hash"]
    finally:
        for program in programs:
            program.close()
    servers = query(run, "SELECT DISTINCT server FROM outcomes")
    assert [server.rpartition("-")[0] for (server,) in servers] == ["sound"]


def test_verification_with_sound_servers_changes_nothing(
    tmp_path: Path, path: str
) -> None:
    file = plugin.experiment(tmp_path, "slow")
    servers = [
        Server(
            tmp_path,
            f"ss-{number}",
            capacity=1,
            PYTHONPATH=path,
            address=f"127.0.0.{number + 1}",
        ).ready()
        for number in range(2)
    ]
    remote = [
        "--servers",
        "2",
        "--no-multicast",
        *(f"--connect={server.endpoint}" for server in servers),
    ]
    hashes = set()
    try:
        for share in ("0.0", "0.3"):
            arguments = [
                "run",
                str(file),
                "--json",
                "--out",
                share,
                "--set",
                f"cluster.verify={share}",
                *remote,
            ]
            hashes.add(
                Optimizer(tmp_path, share, arguments, PYTHONPATH=path).done()[
                    "history_hash"
                ]
            )
    finally:
        for server in servers:
            server.close()
    assert len(hashes) == 1
    assert query(
        tmp_path / "0.3" / "rough",
        "SELECT count(*) FROM events WHERE event LIKE 'server_wrong'",
    ) == [(0,)]
