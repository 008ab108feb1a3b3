"""Members are admitted, others refused in words, and keys change during runs."""

import contextlib
import secrets
import shutil
import signal
import socket
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import NamedTuple

import pytest
import zenoh

from tests.integration import asleep, evacuation
from tests.integration.evacuation import COUNTED
from tests.integration.programs import (
    Optimizer,
    Program,
    Server,
    free_port,
    query,
    wait_until,
)
from tests.lab_keys import issued, of, unpacked
from zswarm import session
from zswarm.plugins.version_hash import version_hash
from zswarm.protocol import codec, keys
from zswarm.protocol.messages import (
    Cancel,
    Lease,
    Message,
    Part,
    Refused,
    Release,
    Renew,
    Reply,
    Requirements,
    Reserve,
)
from zswarm.security import bundle, install
from zswarm.security.authority import Authority
from zswarm.security.keyring import Keyring
from zswarm.security.members import Members, Role
from zswarm.session import Reach

pytestmark = pytest.mark.programs

NOW = datetime.now(UTC)
SMALL = (
    "--set=generations=2",
    "--set=problem.trials=2",
    "--set=problem.settings.steps=5",
    "--set=optimizer.population=10",
)


class Lab(NamedTuple):
    """An authority, and the installed keys of its members, each in its own folder."""

    folder: Path

    def keys(self, holder: str) -> str:
        return str(self.folder / holder)

    def revoke(self, holder: str) -> None:
        with Authority(self.folder / "authority") as authority:
            authority.revoke([holder])

    def bring_members(self, holder: str) -> None:
        """Copy the newest list of members to a user's keys."""
        with Authority(self.folder / "authority") as authority:
            newest = authority.list_of_members()
        file = self.folder / "members.zkeys"
        bundle.write(file, newest)
        install.install_members(bundle.read(file), self.folder / holder)


def make(folder: Path, *holders: tuple[Role, str], now: datetime | None = None) -> Lab:
    """Make a lab whose certificates were issued at a given time."""
    contents = issued(
        folder / "authority", *(of(role, name) for role, name in holders), now=now
    )
    for (_, name), content in zip(holders, contents, strict=True):
        unpacked(folder / name, content)
    return Lab(folder)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Lab:
    folder, some_time_ago = tmp_path_factory.mktemp("lab"), NOW - timedelta(days=60)
    return make(
        folder,
        ("ss", "lab-01"),
        ("ss", "lab-02"),
        ("ot", "alice"),
        ("ot", "bob"),
        ("router", "gate"),
        now=some_time_ago,
    )


@pytest.fixture
def lab(made: Lab, tmp_path: Path) -> Lab:
    """Make a lab that a test may change."""
    shutil.copytree(made.folder, tmp_path / "lab")
    return Lab(tmp_path / "lab")


@pytest.fixture
def server(lab: Lab, tmp_path: Path) -> Iterator[Server]:
    started = serve(lab, tmp_path, "lab-01")
    yield started.ready()
    started.close()


def serve(lab: Lab, folder: Path, name: str, *options: str) -> Server:
    """Start a server in plain form: compiling would take longer than its work."""
    return Server(
        folder,
        name,
        capacity=1,
        options=options,
        protocol="tls",
        ZSWARM_KEYS=lab.keys(name),
        ZSWARM_PLAIN="1",
    )


def evolve(
    folder: Path, name: str, keys_folder: str, *options: str, file: str = ""
) -> Optimizer:
    file = file or evacuation.write(folder, "keyed", 50)
    arguments = ["run", file, "--json", "--no-multicast", *options]
    return Optimizer(folder, name, arguments, ZSWARM_KEYS=keys_folder, ZSWARM_PLAIN="1")


def look(folder: Path, name: str, keys_folder: str, *options: str) -> str:
    """Return the line of ``zswarm-ot servers``."""
    looking = Optimizer(
        folder,
        name,
        ["servers", "--wait", "1", "--no-multicast", *options],
        ZSWARM_KEYS=keys_folder,
    )
    looking.wait()
    return " ".join((looking.out.read_text() + looking.err.read_text()).split())


def ring(folder: str, role: Role, name: str) -> Keyring:
    """Keys that check nothing: any certificate may do anything on this side."""
    members = Members(
        authority="",
        number=1,
        servers=["lab-01", "lab-02"],
        users=["alice", "bob", "mallory"],
        routers=["gate"],
    )
    return Keyring(Path(folder), role, name, "", NOW, members)


@contextlib.contextmanager
def opened(*to: str, as_: Keyring | None) -> Iterator[zenoh.Session]:
    one = session.open_optimizer(Reach(to, multicast=False, keyring=as_))
    try:
        yield one
    finally:
        session.close(one)


def linked(one: zenoh.Session) -> None:
    wait_until(lambda: one.info.links(), "a link is there")


def ask(one: zenoh.Session, key: str, message: Message) -> Reply | None:
    replies = [
        reply.ok
        for reply in one.get(
            key, payload=codec.encode(message), target=zenoh.QueryTarget.ALL, timeout=5.0
        )
    ]
    return (
        codec.decode_reply(replies[0].payload.to_bytes())
        if replies and replies[0] is not None
        else None
    )


def server_id(server: Server) -> str:
    return str(server.events("server_ready")[0]["server"])


def reserve() -> Reserve:
    return Reserve(
        nonce=secrets.token_bytes(16),
        epoch=0,
        slots=1,
        simulator=Part("emergency-exit", {}),
        representation=Part("fully-meshed", {}),
        version_hash=version_hash("emergency-exit", "fully-meshed"),
        trial_timeout_s=60.0,
        trial_memory_mb=0,
    )


# ---- who is let in


def test_a_member_evolves_through_tls_and_its_name_is_the_users(
    lab: Lab, server: Server, tmp_path: Path
) -> None:
    plain = evolve(
        tmp_path, "alone", "none", "--servers", "local", "--out", "alone", *SMALL
    ).done()
    done = evolve(
        tmp_path,
        "alice",
        lab.keys("alice"),
        "--servers",
        "1",
        f"--connect={server.endpoint}",
        *SMALL,
    ).done()
    assert done["history_hash"] == plain["history_hash"]
    assert [event["user"] for event in server.events("lease_granted")] == ["alice"]
    assert not [
        *server.events("link_refused"),
        *server.events("member_refused"),
        *server.events("member_unknown"),
    ]


@pytest.mark.faults
def test_members_meet_through_a_router_that_holds_their_rules(
    lab: Lab, tmp_path: Path
) -> None:
    at = f"tls/127.0.0.1:{free_port()}"
    router = Program(
        tmp_path,
        "gate",
        ["-m", "zswarm.router", "--no-multicast", "--listen", at],
        ZSWARM_KEYS=lab.keys("gate"),
    )
    server = serve(lab, tmp_path, "lab-01", "--connect", at)
    try:
        server.ready()
        through = ("--servers", "1", "--connect", at, "--through-router")
        done = evolve(tmp_path, "alice", lab.keys("alice"), *through, *SMALL).done()
        assert done["evaluations"] > 0
        with opened(at, as_=ring(lab.keys("bob"), "ot", "bob")) as bob:
            wait_until(
                lambda: tokens(bob, keys.ANY_ALIVE),
                "bob sees the server through the router",
            )
            alices = keys.request("default", server_id(server), "alice", "run", "reserve")
            assert ask(bob, alices, reserve()) is None
            bobs = keys.request("default", server_id(server), "bob", "run", "reserve")
            assert isinstance(ask(bob, bobs, reserve()), Lease)
    finally:
        server.close()
        router.close()


@pytest.mark.faults
def test_servers_ask_the_controllers_of_users_each_server_as_itself(
    lab: Lab, server: Server, tmp_path: Path
) -> None:
    """A remote controller passes the rules; a question in another server's name does not."""
    plain = evolve(
        tmp_path, "alone", "none", "--servers", "local", "--out", "alone", *SMALL
    ).done()
    asked = (
        "--set=cluster.controller='optimizer'",
        "--servers",
        "1",
        f"--connect={server.endpoint}",
    )
    assert (
        evolve(tmp_path, "alice", lab.keys("alice"), *asked, *SMALL).done()[
            "history_hash"
        ]
        == plain["history_hash"]
    )
    place = f"tls/127.0.0.1:{free_port()}"
    listening = Reach(
        (), multicast=False, keyring=ring(lab.keys("lab-02"), "ss", "lab-02")
    )
    asker, _ = session.open_server([place], listening)
    with (
        contextlib.closing(asker),
        opened(place, as_=ring(lab.keys("alice"), "ot", "alice")) as alice,
    ):
        heard: list[str] = []

        def answer(query: zenoh.Query) -> None:
            with query:
                heard.append(str(query.key_expr))
                query.reply(
                    query.key_expr, codec.encode(Refused(code="cancelled", reason=""))
                )

        alice.declare_queryable(keys.control("default", "alice", "run", "*"), answer)
        alice.declare_queryable(keys.control("default", "bob", "run", "*"), answer)
        own = keys.control("default", "alice", "run", "lab-02-00000000")

        def replies(key: str) -> int:
            return sum(
                reply.ok is not None
                for reply in asker.get(key, target=zenoh.QueryTarget.ALL, timeout=2.0)
            )

        wait_until(lambda: replies(own), "the server is answered")
        assert not replies(keys.control("default", "alice", "run", "lab-01-00000000")), (
            "in another server's name"
        )
        assert not replies(keys.control("default", "bob", "run", "lab-02-00000000")), (
            "by a user in another one's name"
        )
    assert set(heard) == {own}


def tokens(one: zenoh.Session, key: str) -> list[str]:
    return [
        str(reply.ok.key_expr)
        for reply in one.liveliness().get(key, timeout=5.0)
        if reply.ok is not None
    ]


# ---- who is not


@pytest.mark.parametrize(
    ("who", "at_the_server", "at_the_optimizer"),
    [
        (
            "stranger",
            "does not trust this lab's authority",
            "has keys of another authority than those here",
        ),
        ("expired", "its certificate has expired", None),
        ("not yet", "its certificate is not valid yet", None),
        ("plain", "does not speak TLS", "lets in members only: have keys issued"),
    ],
)
def test_invalid_keys_are_refused_with_a_reason_on_both_sides(
    server: Server,
    tmp_path: Path,
    lab: Lab,
    who: str,
    at_the_server: str,
    at_the_optimizer: str | None,
) -> None:
    to = server.endpoint
    match who:
        case "stranger":
            other = make(tmp_path / "other", ("ot", "alice"))
            folder, used = other.keys("alice"), ring(other.keys("alice"), "ot", "alice")
        case "expired" | "not yet":
            when = NOW + timedelta(days=-30 if who == "expired" else 30)
            unpacked(
                lab.folder / "carol",
                issued(lab.folder / "authority", of("ot", "carol"), days=7, now=when)[0],
            )
            folder, used = lab.keys("carol"), ring(lab.keys("carol"), "ot", "carol")
        case _:
            folder, used, to = "none", None, to.replace("tls/", "tcp/")
    with opened(to, as_=used):
        wait_until(
            lambda: server.events("link_refused"), "the server says whom it refused"
        )
    assert any(
        at_the_server in event["reason"] for event in server.events("link_refused")
    ), server.events("link_refused")
    said = look(tmp_path, "look", folder, "--connect", to)
    if at_the_optimizer is None:  # the program knows before it dials
        assert (
            f"certificate of the user carol {'expired' if who == 'expired' else 'is valid from'}"
            in said
        )
    else:
        assert at_the_optimizer in said


@pytest.mark.faults
def test_a_server_without_keys_is_named(lab: Lab, tmp_path: Path) -> None:
    server = Server(tmp_path, "open", ZSWARM_KEYS="none", ZSWARM_PLAIN="1").ready()
    try:
        said = look(
            tmp_path,
            "look",
            lab.keys("alice"),
            "--connect",
            server.endpoint.replace("tcp/", "tls/"),
        )
        assert "the program there uses no keys: it does not speak TLS" in said
    finally:
        server.close()


@pytest.mark.parametrize(
    ("module", "arguments", "who", "words"),
    [
        (
            "zswarm.ot",
            ["servers"],
            "lab-02",
            "these are the keys of the server lab-02; zswarm-ot needs those of a user",
        ),
        (
            "zswarm.ot",
            ["run", "stadium"],
            "gate",
            "these are the keys of the router gate; zswarm-ot needs those of a user",
        ),
        (
            "zswarm.ss",
            [],
            "alice",
            "these are the keys of the user alice; zswarm-ss needs those of a server",
        ),
        (
            "zswarm.router",
            [],
            "alice",
            "these are the keys of the user alice; zswarm-router needs those of a router",
        ),
    ],
)
def test_keys_of_another_role_are_named(
    lab: Lab, tmp_path: Path, module: str, arguments: list[str], who: str, words: str
) -> None:
    command = ["-m", module, *arguments, "--no-multicast"]
    program = Program(
        tmp_path, "wrong", command, ZSWARM_KEYS=lab.keys(who), ZSWARM_PLAIN="1"
    )
    assert program.wait() == 2
    assert words in program.err.read_text().splitlines()[-1]
    assert not (tmp_path / "runs").exists()


@pytest.mark.faults
def test_a_server_that_came_later_than_the_list_is_named_to_the_user(
    lab: Lab, server: Server, tmp_path: Path
) -> None:
    """Though another one serves the run."""
    unpacked(
        lab.folder / "lab-03", issued(lab.folder / "authority", of("ss", "lab-03"))[0]
    )
    later = serve(lab, tmp_path, "lab-03")
    try:
        later.ready()
        both = (
            "--servers",
            "1",
            f"--connect={server.endpoint}",
            f"--connect={later.endpoint}",
        )
        optimizer = evolve(tmp_path, "alice", lab.keys("alice"), *both, *SMALL)
        optimizer.done()
        assert "ss.lab-03 at " in optimizer.err.read_text()
        assert (
            "is not, or no longer, among the members (list 2): bring the newest list here"
            in optimizer.err.read_text()
        )
    finally:
        later.close()


@pytest.mark.parametrize("who", ["lab-02", "gate", "mallory"])
def test_a_certificate_of_a_nonmember_gives_no_access(
    server: Server, tmp_path: Path, lab: Lab, who: str
) -> None:
    """The certificates are those of a server, a foreign router and a user who is not listed."""
    if who == "mallory":
        unpacked(
            lab.folder / "mallory",
            issued(lab.folder / "authority", of("ot", "mallory"))[0],
        )
    if who == "gate":  # the router's rules let it carry; so it is revoked first
        lab.revoke("gate")
        lab.bring_members("lab-01")
        server.kill(signal.SIGHUP)
        wait_until(lambda: server.events("reloaded"), "it has the new list")
    with opened(server.endpoint, as_=ring(lab.keys(who), "ot", who)) as stranger:
        linked(stranger)
        assert tokens(stranger, keys.ANY_ALIVE) == []
        for user in ("alice", who):
            for verb, message in (
                ("reserve", reserve()),
                ("release", Release(lease=bytes(16))),
            ):
                assert (
                    ask(
                        stranger,
                        keys.request("default", server_id(server), user, "run", verb),
                        message,
                    )
                    is None
                )
        assert (
            ask(stranger, keys.offer("default", server_id(server)), Requirements())
            is None
        )
    assert not server.events("lease_granted")
    unknown = wait_until(lambda: server.events("member_unknown"), "the server names it")
    assert unknown[0]["certificate"].endswith(f".{who}")
    assert "it can ask nothing" in unknown[0]["reason"]


def test_a_user_cannot_use_see_or_cancel_work_of_others(server: Server, lab: Lab) -> None:
    name = server_id(server)
    with (
        opened(server.endpoint, as_=ring(lab.keys("alice"), "ot", "alice")) as alice,
        opened(server.endpoint, as_=ring(lab.keys("bob"), "ot", "bob")) as bob,
    ):
        for one in (alice, bob):
            wait_until(lambda one=one: tokens(one, keys.ANY_ALIVE), "it sees the server")
        token = alice.liveliness().declare_token(
            keys.run_alive("default", "alice", "run")
        )
        lease = ask(
            alice, keys.request("default", name, "alice", "run", "reserve"), reserve()
        )
        assert isinstance(lease, Lease)
        for verb, message in (
            ("renew", Renew(lease=lease.lease)),
            ("cancel", Cancel(lease=lease.lease, batches=[1])),
            ("release", Release(lease=lease.lease)),
        ):
            for key in (
                keys.request("default", name, "alice", "run", verb),
                f"{keys.ROOT}/default/ss/{name}/ot/*/run/{verb}",
                f"{keys.ROOT}/default/ss/{name}/**",
            ):
                assert ask(bob, key, message) is None, key
            own = ask(bob, keys.request("default", name, "bob", "run", verb), message)
            assert not isinstance(own, Lease)
        refused = wait_until(lambda: server.events("member_refused"), "it is logged")
        assert not refused[0]["key"].startswith(f"{keys.ROOT}/default/ss/{name}/ot/bob/")
        assert {event["certificate"] for event in server.events("member_refused")} == {
            "ot.bob"
        }, "alice did nothing wrong"
        assert tokens(bob, f"{keys.ROOT}/default/ot/*/*/alive") == []
        false = bob.liveliness().declare_token(
            keys.run_alive("default", "alice", "false")
        )
        assert isinstance(
            ask(
                alice,
                keys.request("default", name, "alice", "run", "renew"),
                Renew(lease=lease.lease),
            ),
            Lease,
        )
        false.undeclare()
        token.undeclare()


def test_a_users_keys_are_refused_for_a_server(lab: Lab, tmp_path: Path) -> None:
    """Nor is a server another one: its certificate lets it speak in its own name only."""
    at = f"tls/127.0.0.1:{free_port()}"
    for who, role in (("bob", "ot"), ("lab-02", "ss")):
        false, _ = session.open_server(
            [at], Reach(multicast=False, keyring=ring(lab.keys(who), "ss", who))
        )
        try:
            token = false.liveliness().declare_token(
                keys.alive("default", "lab-01-01234567")
            )
            said = look(tmp_path, f"look-{who}", lab.keys("alice"), "--connect", at)
            assert "no server found" in said
            if role == "ot":
                assert "not those of a server or router, but of 'the user bob'" in said
            token.undeclare()
        finally:
            session.close(false)


# ---- keys change


@pytest.mark.faults
@pytest.mark.usefixtures("sleeping")
def test_a_run_outlives_reloads_of_its_server(lab: Lab, tmp_path: Path) -> None:
    """Each is a new session with the keys of then; lease, batches and results stay."""
    server = serve(lab, tmp_path, "lab-01").ready()
    try:
        file = asleep.write(tmp_path, "keyed")
        only = ["--servers=1", f"--connect={server.endpoint}"]
        running = evolve(tmp_path, "alice", lab.keys("alice"), *only, file=file)
        record = tmp_path / "runs" / "keyed"
        for reload in (1, 2):
            before = int((query(record, COUNTED) or [(0,)])[0][0])
            wait_until(
                lambda before=before: (
                    (query(record, COUNTED) or [(0,)])[0][0] > before + 200
                ),
                "trials are counted",
            )
            server.kill(signal.SIGHUP)
            wait_until(
                lambda reload=reload: len(server.events("reloaded")) == reload,
                "it reloaded",
            )
        done = running.done()
        assert done["history_hash"] == asleep.HISTORY
        assert len(server.events("lease_granted")) == 1, (
            "the lease did not outlive the reload"
        )
    finally:
        server.close()


def test_a_revoked_user_is_refused_after_a_reload(
    lab: Lab, server: Server, tmp_path: Path
) -> None:
    assert "lab-01" in look(
        tmp_path, "before", lab.keys("bob"), "--connect", server.endpoint
    )
    lab.revoke("bob")
    lab.bring_members("lab-01")
    server.kill(signal.SIGHUP)
    wait_until(lambda: server.events("reloaded"), "it reloaded")
    said = look(tmp_path, "after", lab.keys("bob"), "--connect", server.endpoint)
    assert (
        "shows no server to bob, who may not be, or no longer be, in its list of members"
        in said
    )
    assert "lab-01" in look(
        tmp_path, "alice", lab.keys("alice"), "--connect", server.endpoint
    )
    assert server.events("member_unknown")[0]["certificate"] == "ot.bob"


def test_a_reload_of_bad_keys_changes_nothing(
    lab: Lab, server: Server, tmp_path: Path
) -> None:
    key = Path(lab.keys("lab-01")) / "key.pem"
    key.chmod(0o644)
    server.kill(signal.SIGHUP)
    wait_until(lambda: server.events("reload_refused"), "it says so")
    assert (
        "others than its owner may read this key"
        in server.events("reload_refused")[0]["reason"]
    )
    assert "lab-01" in look(
        tmp_path, "look", lab.keys("alice"), "--connect", server.endpoint
    )
    assert not server.events("reloaded")


@pytest.mark.faults
def test_a_reload_that_stops_listening_is_undone_as_soon_as_possible(
    lab: Lab, tmp_path: Path
) -> None:
    """The new port is taken, then the old one as well."""
    file, at, wanted = tmp_path / "ss.toml", free_port(), free_port()
    file.write_text(f"listen = ['tls/127.0.0.1:{at}']\nmulticast = false\ncapacity = 1\n")
    server = Program(
        tmp_path,
        "lab-01",
        ["-m", "zswarm.ss", "--config", str(file)],
        ZSWARM_KEYS=lab.keys("lab-01"),
        ZSWARM_PLAIN="1",
    )
    try:
        wait_until(lambda: server.events("server_ready"), "it serves")
        with socket.create_server(("127.0.0.1", wanted)):
            file.write_text(
                f"listen = ['tls/127.0.0.1:{wanted}']\nmulticast = false\ncapacity = 2\n"
            )
            server.kill(signal.SIGHUP)
            wait_until(lambda: server.events("reload_refused"), "it cannot listen there")
            assert server.events("reload_later")[0]["settings"] == ["capacity"]
            to = ("--connect", f"tls/127.0.0.1:{at}")
            assert "lab-01" in look(tmp_path, "before", lab.keys("alice"), *to)
        server.kill(signal.SIGHUP)
        wait_until(lambda: server.events("reloaded"), "the port is free now")
        assert "lab-01" in look(
            tmp_path, "after", lab.keys("alice"), "--connect", f"tls/127.0.0.1:{wanted}"
        )
    finally:
        server.close()


@pytest.mark.faults
def test_a_server_logs_why_its_router_refuses_it(lab: Lab, tmp_path: Path) -> None:
    at = f"tls/127.0.0.1:{free_port()}"
    other = make(tmp_path / "other", ("router", "gate"))
    router = Program(
        tmp_path,
        "gate",
        ["-m", "zswarm.router", "--no-multicast", "--listen", at],
        ZSWARM_KEYS=other.keys("gate"),
    )
    server = serve(lab, tmp_path, "lab-01", "--connect", at)
    try:
        refused = wait_until(lambda: server.events("router_refused"), "it says why")
        assert (refused[0]["endpoint"], refused[0]["reason"]) == (
            at,
            "the program there has keys of another authority than those here",
        )
    finally:
        server.close()
        router.close()


def test_a_server_that_requires_keys_does_not_start_without(tmp_path: Path) -> None:
    file = tmp_path / "ss.toml"
    file.write_text("require_keys = true\n")
    server = Server(
        tmp_path,
        "open",
        options=("--config", str(file)),
        ZSWARM_KEYS="none",
        ZSWARM_PLAIN="1",
    )
    assert server.wait() == 78
    assert server.err.read_text().splitlines()[-1] == (
        "zswarm-ss: require_keys is set, and no keys are installed: zswarm-keys join BUNDLE"
    )


def test_a_server_without_keys_logs_it_in_one_line(tmp_path: Path) -> None:
    server = Server(tmp_path, "open", ZSWARM_KEYS="none", ZSWARM_PLAIN="1")
    try:
        server.ready()
        assert len(server.events("in_the_clear")) == 1
    finally:
        server.close()


@pytest.mark.parametrize("program", ["zswarm.ss", "zswarm.router"])
def test_unencrypted_endpoints_are_refused_with_keys(
    lab: Lab, tmp_path: Path, program: str
) -> None:
    who = "lab-01" if program == "zswarm.ss" else "gate"
    at = f"tcp/127.0.0.1:{free_port()}"
    options = ["--no-multicast", "--listen", at]
    started = Program(
        tmp_path,
        "clear",
        ["-m", program, *options],
        ZSWARM_KEYS=lab.keys(who),
        ZSWARM_PLAIN="1",
    )
    assert started.wait() == 2
    assert "an endpoint must begin with tls/" in started.err.read_text().splitlines()[-1]


def test_a_router_keeps_its_endpoint_when_a_reload_fails(
    lab: Lab, tmp_path: Path
) -> None:
    """A server keeps its old keys on a damaged file, and reloads the repaired one."""
    file, at, wanted = tmp_path / "router.toml", free_port(), free_port()
    file.write_text(f"listen = ['tls/127.0.0.1:{at}']\nmulticast = false\n")
    router = Program(
        tmp_path,
        "gate",
        ["-m", "zswarm.router", "--config", str(file)],
        ZSWARM_KEYS=lab.keys("gate"),
    )
    try:
        wait_until(lambda: router.events("router_ready"), "it routes")
        with socket.create_server(("127.0.0.1", wanted)):
            file.write_text(f"listen = ['tls/127.0.0.1:{wanted}']\nmulticast = false\n")
            router.kill(signal.SIGHUP)
            wait_until(lambda: router.events("reload_refused"), "it cannot listen there")
            with opened(
                f"tls/127.0.0.1:{at}", as_=ring(lab.keys("alice"), "ot", "alice")
            ) as alice:
                linked(alice)
        file.write_text("listen = 3\n")
        router.kill(signal.SIGHUP)
        wait_until(
            lambda: (
                len(router.events("reload_refused")) == 2
                or router.process.poll() is not None
            ),
            "the file is wrong",
        )
        assert router.process.poll() is None, (
            router.process.poll(),
            router.err.read_text()[-300:],
        )
        file.write_text(f"listen = ['tls/127.0.0.1:{wanted}']\nmulticast = false\n")
        router.kill(signal.SIGHUP)
        assert wait_until(lambda: router.events("reloaded"), "it listens there")[0][
            "listen"
        ] == [f"tls/127.0.0.1:{wanted}"]
        router.kill(signal.SIGTERM)
        assert router.wait() == 143
    finally:
        router.close()
