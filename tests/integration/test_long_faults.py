"""Faults that take a minute, because timeouts do."""

from pathlib import Path

import pytest
from paced import Scene, Undisturbed, play_undisturbed
from programs import wait_until
from test_links import HUGE, hang_a_batch

pytestmark = pytest.mark.faults


def test_what_hangs_on_the_way_to_a_stopped_server_goes_elsewhere_in_the_end(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    undisturbed = play_undisturbed(tmp_path_factory.mktemp("undisturbed"), HUGE)
    with Scene(tmp_path, HUGE) as scene:
        optimizer = hang_a_batch(scene)
        wait_until(lambda: scene.events("server_left", "victim"), "zenoh gives the link up", 120.0)
        scene.check(optimizer.done(), undisturbed)
        assert not scene.counted("victim")


def test_an_optimizer_that_was_stopped_until_its_lease_expired_goes_on_by_itself(scene: Scene, undisturbed: Undisturbed) -> None:
    server, pace = scene.server("ss")
    pace.arm()
    optimizer = scene.optimizer(server.endpoint)
    pace.held()
    scene.stop(optimizer.process.pid)
    wait_until(lambda: server.events("lease_expired"), "its lease expires", 120.0)
    pace.let_go()
    scene.go_on(optimizer.process.pid)
    scene.check(optimizer.done(), undisturbed)
    assert optimizer.process.returncode == 0
