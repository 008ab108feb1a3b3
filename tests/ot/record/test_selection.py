"""Champions of every kind of network are written, driven, played and filmed."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from zswarm import evaluate
from zswarm.champion.controller import CHAMPION, Controller, load_controller
from zswarm.kernels.random import Stream
from zswarm.ot.replay import held_out, trace
from zswarm.plugins import registry as plugins

GAME = {"steps": 8, "robots": 1, "width": 8}


@pytest.mark.parametrize("kind", plugins.BUNDLED["representation"])
def test_the_champion_of_every_kind_of_network_is_of_use(
    kind: str, tmp_path: Path
) -> None:
    """An agent that is driven from outside decides what it decided in the trial."""
    settings = msgspec.to_builtins(plugins.load("representation", kind).settings_type())
    simulator, network = evaluate.build("minisim", GAME, kind, settings)
    (genome,) = network.random(1, Stream(1))
    written = Controller(
        simulator="minisim",
        simulator_settings=GAME,
        representation=kind,
        representation_settings=settings,
        inputs=simulator.inputs,
        outputs=simulator.outputs,
        sensors=[],
        actuators=[],
        genome=genome,
        fitness=1.0,
        run="of-a-test",
    )
    (tmp_path / CHAMPION).write_bytes(msgspec.msgpack.encode(written))
    champion = load_controller(tmp_path)
    assert champion == written

    frames = trace.record(simulator, network, [genome], held_out.trial_seed(0, 0)).frames
    assert len(frames) == 9
    turn, driver, path = simulator.reset(held_out.trial_seed(0, 0)), champion.driver(), []
    while turn is not None:
        path.append(simulator.frame().bodies[0])  # type: ignore[union-attr]  # minisim has frames
        turn = simulator.step(driver.act(turn.observations[0])[None])
    assert path == [frame.bodies[0] for frame in frames[:-1]]
    played = held_out.play(champion, 1, 0)
    assert played.fitness.tolist() == list(simulator.outcome().fitness)
    assert np.isfinite(played.metrics).all()
