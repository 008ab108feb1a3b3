"""Slow simulators and cold caches: who plays the probe, and what the user knows of it."""

import re
from pathlib import Path

import pytest

from tests.integration.paced import Scene, Size

pytestmark = pytest.mark.programs


def test_all_slots_play_the_probe_of_a_slow_simulator_at_once(tmp_path: Path) -> None:
    with Scene(tmp_path, Size(generations=1, population=4, trials=1)) as scene:
        server, pace = scene.server("lab", capacity=4)
        pace.set(2.0)
        optimizer = scene.optimizer(server.endpoint)
        optimizer.done()
        (ready,) = server.events("lease_ready")
        assert ready["probe_trials"] >= 1
        assert ready["trial_s"] >= 2.0
        played = [trial.process for trial in pace.played("probe")]
        assert len(set(played)) == 4, "each slot plays some of it"
        assert len(played) <= 8
        said = optimizer.err.read_text()
        assert ": plays trial " in said
        assert " of 8 of paced" in said


def test_the_user_knows_that_kernels_are_compiled_into_an_empty_cache(
    tmp_path: Path,
) -> None:
    size = Size(generations=1, population=4, trials=1, compiled=True)
    with Scene(tmp_path, size) as scene:
        scene.environment["ZSWARM_CACHE"] = str(tmp_path / "cache")
        server, pace = scene.server("lab", capacity=1)
        pace.set(0.0)
        optimizer = scene.optimizer(server.endpoint)
        optimizer.done()
        assert re.search("compiling kernel 1 of [0-9]+, once", optimizer.err.read_text())
