"""Faults that take a minute, because timeouts do."""

from pathlib import Path

import pytest

from tests.integration.paced import Scene, Undisturbed, play_undisturbed
from tests.integration.programs import wait_until
from tests.integration.test_links import HUGE, hang_a_batch

pytestmark = pytest.mark.faults


def test_batches_blocked_on_the_way_to_a_stopped_server_move_to_another(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    undisturbed = play_undisturbed(tmp_path_factory.mktemp("undisturbed"), HUGE)
    with Scene(tmp_path, HUGE) as scene:
        optimizer = hang_a_batch(scene)
        # Its trials may all be started again elsewhere before zenoh gives the link up.
        wait_until(
            lambda: (
                optimizer.process.poll() is not None
                or scene.events("server_left", "victim")
            ),
            "zenoh gives the link up, or the run ends",
            120.0,
        )
        scene.check(optimizer.done(), undisturbed)
        assert not scene.counted("victim")


def test_an_optimizer_continues_after_its_lease_expired(
    scene: Scene, undisturbed: Undisturbed
) -> None:
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
