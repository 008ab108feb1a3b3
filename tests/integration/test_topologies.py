"""Topologies (docs/network.md): real programs on networks of namespaces.

However servers are reached, and whatever happens to the router, the result is that of a run on one
machine.
"""

import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.integration import asleep
from tests.integration.asleep import HISTORY
from tests.integration.evacuation import COUNTED, TRIALS
from tests.integration.lab import Host, Lab
from tests.integration.programs import Optimizer, Program, query, wait_until

pytestmark = pytest.mark.faults

SERVED = "SELECT count(DISTINCT server) FROM outcomes"


@pytest.fixture
def lab() -> Iterator[Lab]:
    with Lab() as made:
        yield made


class Site:
    """Start programs on hosts of a lab, and stop them all at the end."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.programs: list[Program] = []
        asleep.write(folder, "linked")
        self._environment = asleep.installed(folder)

    def server(self, host: Host, *options: str) -> Program:
        arguments = [
            "-m",
            "zswarm.ss",
            "--capacity",
            "1",
            "--name",
            f"ss-{len(self.programs)}",
            *options,
        ]
        name = f"ss-{len(self.programs)}"
        server = Program(self.folder, name, arguments, host.inside, **self._environment)
        return self._ready(server, "server_ready")

    def router(self, host: Host, *options: str) -> Program:
        arguments = ["-m", "zswarm.router", *options]
        return self._ready(
            Program(self.folder, f"router-{len(self.programs)}", arguments, host.inside),
            "router_ready",
        )

    def optimizer(self, host: Host, *arguments: str) -> Optimizer:
        name = f"ot-{len(self.programs)}"
        started = Optimizer(
            self.folder, name, list(arguments), host.inside, **self._environment
        )
        self.programs.append(started)
        return started

    def run(self, host: Host, *options: str, servers: str = "2") -> Optimizer:
        return self.optimizer(
            host, "run", "experiment.toml", "--json", "--servers", servers, *options
        )

    def counted(self, sql: str = COUNTED) -> int:
        rows = query(self.folder / "runs" / "linked", sql)
        return int(rows[0][0]) if rows else 0

    def wait_counted(self, trials: int) -> None:
        wait_until(lambda: self.counted() > trials, f"{trials} trials are counted")
        assert self.counted() < TRIALS, "the run is over too early for this test"

    def _ready(self, program: Program, event: str) -> Program:
        self.programs.append(program)
        wait_until(
            lambda: program.events(event) or program.process.poll() is not None,
            f"{program.err} says {event}",
        )
        assert program.process.poll() is None, program.err.read_text()
        return program


@pytest.fixture
def site(tmp_path: Path) -> Iterator[Site]:
    made = Site(tmp_path)
    yield made
    for program in made.programs:
        program.close()


# ---- found directly


def test_servers_of_a_plain_lan_are_found_without_an_option(lab: Lab, site: Site) -> None:
    lan = lab.network()
    for _ in range(2):
        site.server(lab.host(lan))
    assert site.run(lab.host(lan)).done()["history_hash"] == HISTORY
    assert site.counted(SERVED) == 2


def test_servers_of_a_plain_lan_that_start_after_the_optimizer_are_found(
    lab: Lab, site: Site
) -> None:
    """They do the whole rest: the one that was there first is killed before they start."""
    lan = lab.network()
    first = site.server(lab.host(lan))
    optimizer = site.run(lab.host(lan), servers="1")
    site.wait_counted(100)
    first.kill()
    for _ in range(2):
        site.server(lab.host(lan))
    assert optimizer.done()["history_hash"] == HISTORY
    assert site.counted(SERVED) == 3


def test_given_endpoints_need_no_multicast(lab: Lab, site: Site) -> None:
    lan = lab.network()
    hosts = [lab.host(lan) for _ in range(2)]
    for host in hosts:
        site.server(host, "--no-multicast", "--listen", f"tcp/{host.address}:7467")
    connect = [f"--connect=tcp/{host.address}:7467" for host in hosts]
    assert (
        site.run(lab.host(lan), "--no-multicast", *connect).done()["history_hash"]
        == HISTORY
    )
    assert site.counted(SERVED) == 2


# ---- a router


def test_a_router_introduces_servers_and_may_die_in_the_middle(
    lab: Lab, site: Site
) -> None:
    """Data flows directly without the router; back again, it introduces a new server."""
    lan = lab.network()
    middle, *hosts = [lab.host(lan) for _ in range(4)]
    options = ["--no-multicast", f"--connect=tcp/{middle.address}:7466"]
    router = site.router(middle, "--no-multicast")
    servers = [site.server(host, *options) for host in hosts[:2]]
    optimizer = site.run(lab.host(lan), *options)
    wait_until(lambda: site.counted(SERVED) == 2, "both servers evaluate")
    router.kill()
    router.wait()
    site.wait_counted(site.counted() + 400)
    for server in servers:
        server.kill()
    site.server(hosts[2], *options)
    site.router(middle, "--no-multicast")
    assert optimizer.done()["history_hash"] == HISTORY
    assert site.counted(SERVED) == 3


def beyond(lab: Lab) -> tuple[Host, list[Host], Host]:
    """A router between two networks, two servers' hosts in one, the optimizer's in the other."""
    inner, outer = lab.network(), lab.network()
    return lab.host(inner, outer), [lab.host(inner) for _ in range(2)], lab.host(outer)


def test_a_router_carries_everything_and_may_be_restarted_in_the_middle(
    lab: Lab, site: Site
) -> None:
    middle, hosts, workstation = beyond(lab)
    router = site.router(middle, "--no-multicast")
    for host in hosts:
        site.server(host, "--no-multicast", f"--connect=tcp/{middle.address}:7466")
    options = [
        "--no-multicast",
        "--through-router",
        f"--connect=tcp/{middle.addresses[1]}:7466",
    ]
    optimizer = site.run(workstation, *options)
    site.wait_counted(100)
    router.kill()
    router.wait()
    wait_until(
        lambda: "none computes now" in optimizer.err.read_text(),
        "the optimizer misses its servers",
    )
    assert site.counted() < TRIALS
    site.router(middle, "--no-multicast")
    assert optimizer.done()["history_hash"] == HISTORY
    assert site.counted(SERVED) == 2


def test_a_router_that_multicast_finds_may_start_after_the_optimizer(
    lab: Lab, site: Site
) -> None:
    """Until then the optimizer's own slots compute, and it takes what comes through the router."""
    middle, hosts, workstation = beyond(lab)
    optimizer = site.run(
        workstation,
        "--through-router",
        "--set=cluster.local_slots=1",
        "--set=generations=100000",
        servers="auto",
    )
    wait_until(site.counted, "its own slots compute")
    site.router(middle)
    site.server(hosts[0], f"--connect=tcp/{middle.address}:7466")
    wait_until(lambda: site.counted(SERVED) == 2, "the server beyond the router computes")
    optimizer.kill(signal.SIGINT)
    assert optimizer.wait() == 130


# ---- why nobody is found


def findings(optimizer: Optimizer) -> list[str]:
    """Return the findings of ``servers --json``."""
    assert optimizer.wait() == 4, optimizer.err.read_text()
    assert optimizer.lines() == []
    first, *rest = " ".join(optimizer.err.read_text().split()).split(" - ")
    assert first.startswith("no server found in realm ")
    return rest


def look(site: Site, host: Host, *options: str) -> list[str]:
    return findings(site.optimizer(host, "servers", "--json", "--wait", "2", *options))


def test_servers_beyond_a_router_are_named_with_the_option_that_reaches_them(
    lab: Lab, site: Site
) -> None:
    middle, hosts, workstation = beyond(lab)
    site.router(middle)
    server = site.server(
        hosts[0], "--no-multicast", f"--connect=tcp/{middle.address}:7466"
    )
    name, outside = (
        server.events("server_ready")[0]["server"],
        f"tcp/{middle.addresses[1]}:7466",
    )
    expected = (
        f"{outside}: this router sees {name}, which cannot be dialled from here: "
        "set through_router = true (--through-router)"
    )
    assert look(site, workstation, "--no-multicast", "--connect", outside) == [expected]
    assert look(site, workstation) == [expected], "multicast finds the router"
    failed = site.run(workstation, "--no-multicast", "--connect", outside, servers="1")
    assert failed.wait() == 4
    assert expected in failed.err.read_text().splitlines()
    seen = site.optimizer(
        workstation,
        "servers",
        "--json",
        "--through-router",
        "--no-multicast",
        "--connect",
        outside,
    )
    assert seen.wait() == 0
    assert [line["server"] for line in seen.lines()] == [name]


def test_each_endpoint_that_leads_nowhere_is_named_with_the_reason(
    lab: Lab, site: Site
) -> None:
    lan = lab.network()
    host, workstation = lab.host(lan), lab.host(lan)
    site.programs.append(
        Program(site.folder, "web", ["-m", "http.server", "8000"], host.inside)
    )
    dial = "import socket; socket.create_connection(('127.0.0.1', 8000))"
    wait_until(lambda: host.succeeds("python3", "-c", dial), "the web server is up")
    site.router(host, "--no-multicast")
    ends = [f"tcp/{host.address}:{port}" for port in (7999, 8000, 7466)]
    ends += [
        f"tcp/10.77.{lan.number}.99:7467",
        "tcp/10.99.0.1:7467",
        "tcp/nobody.invalid:7467",
    ]
    found = look(
        site, workstation, "--no-multicast", *(f"--connect={end}" for end in ends)
    )
    reasons = dict(line.split(": ", 1) for line in found)
    assert list(reasons) == ends
    for end, words in zip(
        ends,
        [
            "connection refused",
            "no zswarm",
            "no server is connected to it",
            "No route",
            "unreachable",
            "not known",
        ],
        strict=True,
    ):
        assert words in reasons[end]


def test_missing_endpoints_and_missing_multicast_are_reported(
    lab: Lab, site: Site
) -> None:
    lan = lab.network()
    assert look(site, lab.host(lan), "--no-multicast")[0].startswith(
        "multicast is off and connect is empty"
    )
    assert look(site, lab.host(lan))[0].startswith("no server answers to multicast")
    assert look(site, lab.host())[0].startswith(
        "multicast does not work on this machine: no network interface"
    )


def test_servers_of_another_realm_are_named_with_the_option(lab: Lab, site: Site) -> None:
    lan = lab.network()
    site.server(lab.host(lan), "--realm", "lab7")
    assert look(site, lab.host(lan)) == [
        "1 server in realm lab7, none in default: use --realm lab7, or start servers with --realm "
        "default"
    ]


def test_a_server_without_multicast_logs_it(lab: Lab, site: Site) -> None:
    assert site.server(lab.host()).events("multicast_unavailable")
    assert site.router(lab.host()).events("multicast_unavailable")
    assert not site.server(lab.host(lab.network())).events("multicast_unavailable")


def test_all_servers_are_shown_with_their_addresses(lab: Lab, site: Site) -> None:
    lan = lab.network()
    hosts = [lab.host(lan) for _ in range(2)]
    names = [site.server(host).events("server_ready")[0]["server"] for host in hosts]
    site.server(lab.host(lan), "--realm", "lab7")
    seen = site.optimizer(lab.host(lan), "servers", "--json")
    assert seen.wait() == 0
    assert {line["server"]: line["address"] for line in seen.lines()} == {
        name: f"tcp/{host.address}:7467" for name, host in zip(names, hosts, strict=True)
    }
    assert "lab7 (1)" in seen.err.read_text()
