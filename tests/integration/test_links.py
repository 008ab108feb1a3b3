"""A run on links that are cut, reset, slow or stuck has the undisturbed history."""

import signal
import time
from pathlib import Path

import pytest

from tests.integration.lab import Lab
from tests.integration.paced import Scene, Size, Undisturbed, play_undisturbed, query
from tests.integration.programs import Optimizer, wait_until
from tests.integration.proxy import Proxy
from zswarm.ot.commands.shared.exits import EXIT_INTERRUPTED
from zswarm.session import LINK_TIMEOUT_S

pytestmark = pytest.mark.faults

# A genome has 164,000 bytes.
LARGE = Size(generations=1, population=10, trials=4, hidden=200)
# A genome has 1 MB, a batch 4 MB.
HUGE = Size(generations=1, population=60, trials=1, hidden=500, compiled=True)


def wait_for(seconds: float) -> None:
    """Wait for the length of a fault that is about time."""
    end = time.monotonic() + seconds
    wait_until(lambda: time.monotonic() >= end, "time passes", seconds + 1.0)


@pytest.mark.parametrize("servers", [1, 2])
def test_a_link_that_is_cut_for_less_than_the_link_timeout_costs_nothing(
    scene: Scene, undisturbed: Undisturbed, servers: int
) -> None:
    with Lab() as lab:
        network = lab.network()
        hosts = [lab.host(network) for _ in range(servers)]
        desk = lab.host(network)
        paced = [
            scene.server(f"ss-{i}", address=host.address, inside=host.inside)
            for i, host in enumerate(hosts)
        ]
        _, pace = paced[0]
        pace.arm()
        optimizer = scene.optimizer(
            *(server.endpoint for server, _ in paced), inside=desk.inside
        )
        pace.held()
        hosts[0].cut()
        pace.let_go()
        wait_for(3.0)
        hosts[0].mend()
        done = optimizer.done()
        scene.check(done, undisturbed)
        assert done["requeued"] == 0
        assert not scene.events("server_left")
        played = sum(len(pace.played()) for _, pace in paced)
        assert 0 <= played - undisturbed.trials <= scene.second_starts()


def test_work_moves_to_another_server_after_the_link_timeout(
    scene: Scene, undisturbed: Undisturbed
) -> None:
    with Lab() as lab:
        network = lab.network()
        near, far, desk = (lab.host(network) for _ in range(3))
        victim, pace = scene.server("victim", address=far.address, inside=far.inside)
        other, others_pace = scene.server(
            "other", address=near.address, inside=near.inside
        )
        pace.arm()
        others_pace.arm()  # so that work is left for when the victim is back
        others_pace.set(0.1)
        optimizer = scene.optimizer(victim.endpoint, other.endpoint, inside=desk.inside)
        pace.held()
        others_pace.held()
        far.cut()
        wait_until(
            lambda: scene.events("server_left", "victim"), "the server is taken for gone"
        )
        pace.let_go()
        others_pace.let_go()
        scene.wait_for_more("other")
        others_pace.arm()
        others_pace.held()
        far.mend()
        scene.wait_for_more("victim")
        others_pace.let_go()
        scene.check(optimizer.done(), undisturbed)


@pytest.mark.parametrize("when_back", ["finished", "at it"])
def test_trials_of_the_only_server_are_neither_lost_nor_repeated_after_a_link_cut(
    scene: Scene, undisturbed: Undisturbed, when_back: str
) -> None:
    with Lab() as lab:
        network = lab.network()
        host, desk = lab.host(network), lab.host(network)
        server, pace = scene.server("ss", address=host.address, inside=host.inside)
        pace.arm()
        optimizer = scene.optimizer(server.endpoint, inside=desk.inside)
        pace.held()
        host.cut()
        wait_until(lambda: scene.events("server_left"), "the server is taken for gone")
        out = int(scene.events("server_left")[0].split()[0])
        if when_back == "finished":
            pace.let_go()
            wait_until(
                lambda: len(pace.played()) == out, "the server has played what it had"
            )
        host.mend()
        wait_until(
            lambda: scene.events("server_back") or scene.events("lease_ready"),
            "the server is there again",
        )
        pace.let_go()
        scene.check(optimizer.done(), undisturbed)
        assert len(pace.played()) == undisturbed.trials, "a trial was played twice"
        assert len(server.events("lease_granted")) == 1, "the lease outlived the cut"


def test_trials_of_the_only_server_are_not_repeated_after_a_link_reset(
    scene: Scene, undisturbed: Undisturbed
) -> None:
    server, pace = scene.server("ss")
    pace.arm()
    with Proxy(server.endpoint) as link:
        optimizer = scene.optimizer(link.endpoint)
        pace.held()
        link.reset()
        wait_until(lambda: link.connections >= 2, "the optimizer dials again")
        pace.let_go()
        scene.check(optimizer.done(), undisturbed)
    assert len(pace.played()) == undisturbed.trials, "a trial was played twice"
    assert len(server.events("lease_granted")) == 1, "the lease outlived the reset"


def test_a_link_of_20_kilobytes_a_second_is_slow_and_stays(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    undisturbed = play_undisturbed(tmp_path_factory.mktemp("undisturbed"), LARGE)
    with Scene(tmp_path, LARGE) as scene:
        far, _ = scene.server("far")
        near, _ = scene.server("near")
        with Proxy(far.endpoint, rate=20_000) as link:
            # The small buffer makes a send last as long as the link needs, as it does for larger
            # messages.
            optimizer = scene.optimizer(f"{link.endpoint}#so_sndbuf=16384", near.endpoint)
            done = optimizer.done()
            scene.check(done, undisturbed)
            servers = [
                name.partition("-")[0]
                for (name,) in query(scene.run, "SELECT server FROM outcomes ORDER BY id")
            ]
            assert servers[0] == "near", "the slow link kept the other server waiting"
            assert servers.count("far") < servers.count("near")
            assert link.connections == 1
            assert done["requeued"] == 0
            assert not scene.events("server_left")
            assert not scene.events("server_silent")


@pytest.mark.parametrize(("hidden", "least", "most"), [(1, 0.1, 0.6), (100, 0.0, 0.2)])
def test_a_server_behind_a_long_slow_link_gets_the_trials_that_it_helps_with(
    tmp_path: Path,
    tmp_path_factory: pytest.TempPathFactory,
    hidden: int,
    least: float,
    most: float,
) -> None:
    """Behind 1 Mbit/s and 100 ms: of small genomes it gets a third, of 42 kB a twentieth.

    How long generations take with it is in ``tests/ot/cluster/test_unequal_machines.py``.
    """
    size = Size(4, population=40, trials=4, hidden=hidden, compiled=hidden > 1)
    undisturbed = play_undisturbed(tmp_path_factory.mktemp("undisturbed"), size)
    with Scene(tmp_path, size) as scene:
        (near, pace), (far, far_pace) = (
            scene.server(name, capacity=4) for name in ("near", "far")
        )
        pace.set(0.05)
        far_pace.set(0.05)
        with Proxy(far.endpoint, rate=125_000, delay_s=0.1) as link:
            scene.check(scene.optimizer(near.endpoint, link.endpoint).done(), undisturbed)
            assert least <= scene.counted("far") / scene.counted() <= most


def test_four_megabytes_to_a_stopped_server_do_not_delay_others(tmp_path: Path) -> None:
    """A link timeout on both sides loses nothing either; the run can be stopped meanwhile."""
    with Scene(tmp_path, HUGE) as scene:
        optimizer = hang_a_batch(scene)
        assert not scene.events("server_left", "other")
        assert not scene.counted("victim")
        optimizer.kill(signal.SIGINT)
        assert optimizer.wait() == EXIT_INTERRUPTED, optimizer.err.read_text()
        assert not scene.events("server_left", "victim"), "its batch still hangs"


def hang_a_batch(scene: Scene) -> Optimizer:
    """Stop a server during a send of 4 MB, which must not stop another server."""
    victim, victims_pace = scene.server("victim")
    other, pace = scene.server("other")
    pace.arm()
    victims_pace.arm()  # of what arrives before it is stopped, nothing is played
    link = scene.enter(Proxy(victim.endpoint, rate=1_000_000))
    optimizer = scene.optimizer(f"{link.endpoint}#so_sndbuf=16384", other.endpoint)
    pace.held()
    wait_until(lambda: link.there > 500_000, "a batch is on the way")
    scene.stop(victim.process.pid)
    pace.set(0.2)
    for seconds in (0.0, 2.5 * LINK_TIMEOUT_S):
        wait_for(seconds)
        pace.let_go()
        scene.wait_for_more("other")
        pace.arm()
        pace.held()
    assert link.there < 4_000_000, "the batch still hangs"
    pace.let_go()
    return optimizer
