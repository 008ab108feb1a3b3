"""A recorded trial is computed again, bit for bit, and kept in few bytes."""

import json
import math
import sqlite3
import struct
import zlib
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from tests.evaluated_record import SHORT, played
from tests.ot.record.sealing import reseal
from zswarm import evaluate
from zswarm.champion.controller import CHAMPION, Controller
from zswarm.errors import ConfigError
from zswarm.kernels.random import Stream
from zswarm.ot.record.reader import Run
from zswarm.ot.replay import steps
from zswarm.ot.replay.encoding import LEVELS, MAGIC, STEPS, TURN, encode
from zswarm.ot.replay.trace import Trace, record, trace
from zswarm.sims.minisim import Minisim
from zswarm.sims.simulator import Body, Frame, Rectangle

HOSTILE = '</script><b>"\x1b[31m'


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a run of two generations with four candidates."""
    return played(tmp_path_factory.mktemp("runs"), overrides=(*SHORT, "problem.trials=2"))


def changed(folder: Path, to: Path, sql: str, *values: Any) -> Run:
    """Return a copy of a run with a changed record."""
    to.mkdir()
    for name in ("experiment.toml", "run.sqlite"):
        (to / name).write_bytes((folder / name).read_bytes())
    database = sqlite3.connect(to / "run.sqlite")
    database.execute(sql, values)
    database.commit()
    database.close()
    reseal(to)
    return Run(to)


def decoded(raw: bytes) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """A naive reader of a trace's bytes: header and tables."""
    assert raw[:8] == MAGIC
    version, length = struct.unpack("<II", raw[8:16])
    assert version == 1
    header, packed, tables, at = (
        json.loads(raw[16 : 16 + length]),
        zlib.decompress(raw[16 + length :]),
        {},
        0,
    )
    for track in header["tracks"]:
        rows, columns, size = track["rows"], track["columns"], track["bytes"]
        count = rows * columns
        numbers = [
            sum(
                packed[at + half * count + place] << 8 * (size - 1 - half)
                for half in range(size)
            )
            for place in range(count)
        ]
        steps = np.array(numbers).reshape(columns, rows).T
        tables[track["name"]] = np.cumsum(steps, axis=0) % 256**size
        at += count * size
    assert at == len(packed)
    return header, tables


@pytest.mark.parametrize(
    ("generation", "candidate", "trial"), [(0, 0, 0), (0, 3, 1), (1, 2, 0)]
)
def test_every_trial_of_the_record_is_played_again_with_the_same_bits(
    folder: Path, generation: int, candidate: int, trial: int
) -> None:
    run = Run(folder)
    found = trace(run, generation, candidate, trial)
    (recorded,) = [
        one
        for one in run.trials(generation)
        if (one["candidate"], one["trial"]) == (candidate, trial)
    ]
    assert found.note == ""
    assert list(found.fitness) == recorded["fitness"]
    assert found.metrics == recorded["metrics"]
    assert found.about["run"] == "minisim"
    assert (len(found.frames), found.rounds, found.every) == (31, 30, 1)


def test_the_default_trace_is_of_the_best_candidate_of_the_run(folder: Path) -> None:
    run, found = Run(folder), trace(Run(folder))
    everybody = [
        (one["fitness"], -g, -one["candidate"])
        for g in range(2)
        for one in run.candidates(g)
    ]
    _, generation, candidate = max(everybody)
    assert (
        found.about["generation"],
        found.about["candidate"],
        found.about["trial"],
    ) == (
        -generation,
        -candidate,
        0,
    )


def test_the_default_trace_is_of_the_champion_where_another_one_is_the_best(
    folder: Path, tmp_path: Path
) -> None:
    """An assessment may choose another one than the best in search; it is what is exported."""
    run = changed(folder, tmp_path / "run", "SELECT 1")
    genome = run.candidates(0)[3]["genome"]
    champion = Controller(
        simulator="minisim",
        simulator_settings={},
        representation="fully-meshed",
        representation_settings={},
        inputs=1,
        outputs=1,
        sensors=[],
        actuators=[],
        genome=genome,
        fitness=0.0,
        run="minisim",
    )
    (tmp_path / "run" / CHAMPION).write_bytes(msgspec.msgpack.encode(champion))
    about = trace(run).about
    assert (about["generation"], about["candidate"]) == (0, 3)
    assert steps.choose(run, None, None, 0).trials == [(0, 0)]


def test_a_genome_of_which_one_bit_differs_is_another_trial(
    folder: Path, tmp_path: Path
) -> None:
    """The difference is said in one line."""
    before = Run(folder).candidates(0)[1]["genome"]
    for at in range(3, len(before), 4):  # exponents and signs of the weights
        genome = bytearray(before)
        genome[at] ^= 0x40 if genome[at] < 0x40 else 0x80
        sql = "UPDATE candidates SET genome = ? WHERE generation = 0 AND candidate = 1"
        found = trace(changed(folder, tmp_path / str(at), sql, bytes(genome)), 0, 1)
        if found.note:
            break
    assert found.note.startswith("the record has ")
    assert "when it is played again" in found.note
    assert "\n" not in found.note
    assert encode(found) != encode(trace(Run(folder), 0, 1))


def test_another_fitness_in_the_record_is_noted(folder: Path, tmp_path: Path) -> None:
    """One bit of it is enough."""
    raw = bytearray(
        sqlite3.connect(folder / "run.sqlite")
        .execute("SELECT fitness FROM outcomes WHERE id = 1")
        .fetchone()[0]
    )
    raw[0] ^= 1
    found = trace(
        changed(
            folder,
            tmp_path / "x",
            "UPDATE outcomes SET fitness = ? WHERE id = 1",
            bytes(raw),
        ),
        0,
        0,
        0,
    )
    assert found.note.startswith("the record has fitness ")


def test_a_run_of_other_code_is_played_where_the_bits_agree_and_else_refused(
    folder: Path, tmp_path: Path
) -> None:
    other = "UPDATE meta SET value = ? WHERE key = 'version_hash'"
    assert trace(changed(folder, tmp_path / "agrees", other, "f" * 32), 0, 0).note == ""
    run = changed(folder, tmp_path / "differs", other, "f" * 32)
    database = sqlite3.connect(run.folder / "run.sqlite")
    database.execute("UPDATE outcomes SET fitness = zeroblob(length(fitness))")
    database.commit()
    database.close()
    reseal(run.folder)
    run = Run(run.folder)
    with pytest.raises(
        ConfigError,
        match=r"differs: computed by other code \(version hash f+, here [0-9a-f]{32}\), and trial "
        r"0",
    ):
        trace(run, 0, 0)


@pytest.mark.parametrize(
    ("numbers", "text"),
    [
        ((7, None, 0), "no generation 8; it has generations 1 to 2"),
        ((-1, None, 0), "no generation 0; it has generations 1 to 2"),
        ((0, 4, 0), "no candidate 4 in generation 1; it has candidates 0 to 3"),
        ((1, 0, 2), "no trial 2 of candidate 0 in generation 2; it has trials 0 to 1"),
        ((1, 0, -1), "no trial -1 of candidate 0 in generation 2; it has trials 0 to 1"),
    ],
)
def test_a_nonexistent_trial_is_refused_with_the_existing_ones(
    folder: Path, numbers: tuple[int, ...], text: str
) -> None:
    with pytest.raises(ConfigError) as refused:
        trace(Run(folder), *numbers)  # type: ignore[arg-type]  # as a user may ask
    assert str(refused.value) == f"{folder}: {text}"


def test_a_genome_that_does_not_fit_its_network_is_reported_as_damage(
    folder: Path, tmp_path: Path
) -> None:
    run = changed(folder, tmp_path / "x", "UPDATE candidates SET genome = x'00'")
    with pytest.raises(
        ConfigError,
        match="damaged: a genome does not fit its network: a genome has 1 bytes",
    ):
        trace(run, 0, 0)


def test_a_recorded_game_is_replayed_with_its_players(tmp_path: Path) -> None:
    """Trials of a candidate are those of all its games; each participant's fitness is compared."""
    games = np.array([[0, 1], [2, 3], [3, 0]])
    folder = played(
        tmp_path, "minisim-duel", (*SHORT, "problem.trials=1"), generations=1, games=games
    )
    found = trace(Run(folder), 0, 0, 1)
    assert (found.about["players"], found.note, len(found.fitness)) == ([3, 0], "", 2)
    with pytest.raises(
        ConfigError,
        match="no trial 2 of candidate 0 in generation 1; it has trials 0 to 1",
    ):
        trace(Run(folder), 0, 0, 2)


def test_observations_and_actions_equal_those_of_the_trial() -> None:
    """Turns of minisim have all observations, from which the network decides again."""
    built, network = evaluate.build(
        "minisim", {"steps": 9, "robots": 3, "width": 8}, "fully-meshed", {"hidden": 3}
    )
    (genome,) = network.random(1, Stream(3))
    found = record(built, network, [genome], 5)
    parameters = network.parameters([genome])
    for number, turn in enumerate(evaluate.turns(built, network, parameters, 5)):
        assert np.array_equal(found.inputs[number], turn.observations)
        assert found.frames[number] == built.frame()
    states = np.zeros((3, network.state_size), np.float32)
    for number in range(9):
        for agent in range(3):
            output = np.empty(2, np.float32)
            network.step(
                parameters[0], states[agent], found.inputs[number, agent], output
            )
            assert np.array_equal(found.outputs[number, agent], output)
            assert np.array_equal(found.hidden[number, agent], states[agent, :3])
    assert list(found.neurons) == ["hidden 1", "hidden 2", "hidden 3"]


def test_agents_that_do_not_act_in_a_round_have_no_numbers() -> None:
    """Robots of the emergency exit that are out."""
    built, network = evaluate.build(
        "emergency-exit",
        {"agents": 12, "width": 5, "height": 5, "exits": 5, "blockades": 0},
        "fully-meshed",
        {},
    )
    found = record(built, network, network.random(1, Stream(2)), 0)
    acts = ~np.isnan(found.inputs).any(axis=2)
    outside = np.array(
        [
            [body.kind == "robot outside" for body in frame.bodies]
            for frame in found.frames[:-1]
        ]
    )
    assert not acts[outside].any()
    assert acts[~outside].all()
    assert not acts.all()


def test_the_encoding_keeps_positions_and_numbers_within_its_resolution() -> None:
    """Positions are kept to a 65,535th of the field, numbers to a 254th of their range."""
    built, network = evaluate.build(
        "turtlebot-exit", {"steps": 12, "robots": 2}, "fully-meshed", {}
    )
    found = record(built, network, network.random(1, Stream(1)), 5)
    header, tables = decoded(encode(found))
    assert [header["kinds"][kind] for kind in tables["kind"][0]] == ["robot", "robot"]
    by_name = {track["name"]: track for track in header["tracks"]}
    for number, frame in enumerate(found.frames):
        for column, body in enumerate(frame.bodies):
            for name, value in (("x", body.x), ("y", body.y)):
                low, high = by_name[name]["low"][0], by_name[name]["high"][0]
                assert low + tables[name][number, column] / STEPS * (
                    high - low
                ) == pytest.approx(value, abs=(high - low) / STEPS)
            assert body.heading is not None
            turned = tables["heading"][number, column] / TURN * 2 * math.pi
            assert math.cos(turned - body.heading) == pytest.approx(1.0, abs=1e-8)
    low, high = np.array(by_name["inputs"]["low"]), np.array(by_name["inputs"]["high"])
    levels = tables["inputs"].reshape(found.inputs.shape)
    assert (
        np.abs(low + (levels - 1) / LEVELS * (high - low) - found.inputs).max()
        <= ((high - low) / LEVELS).max()
    )


def test_a_long_trial_is_thinned_with_its_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("zswarm.ot.replay.trace.MOST_FRAMES", 8)
    built, network = evaluate.build(
        "minisim", {"steps": 30, "robots": 2}, "fully-meshed", {}
    )
    found = record(built, network, network.random(1, Stream(1)), 5)
    assert (found.every, found.rounds, len(found.frames), len(found.inputs)) == (
        8,
        30,
        5,
        4,
    )
    assert [found.at(number) for number in range(5)] == [0, 8, 16, 24, 30]
    whole = list(found.frames)
    monkeypatch.undo()
    every = record(built, network, network.random(1, Stream(1)), 5)
    assert whole == [*every.frames[:30:8], every.frames[30]]


@pytest.mark.long
def test_a_thousand_rounds_of_a_hundred_robots_fit_in_600_kb() -> None:
    """The robots wander about."""
    built, network = evaluate.build(
        "arena",
        {"robots": 100, "steps": 1000, "side": 8.0},
        "fully-meshed",
        {"weight_range": 4.0},
    )
    sizes = [
        len(encode(record(built, network, [genome], 5)))
        for genome in network.random(4, Stream(1))
    ]
    assert max(sizes) < 600_000, sizes


class Drawn(Minisim):
    """A simulator whose pictures a test chooses."""

    pictures: list[Any]

    def frame(self) -> Frame:
        picture = self.pictures.pop(0) if len(self.pictures) > 1 else self.pictures[0]
        if isinstance(picture, Exception):
            raise picture
        return picture


FRAME = Frame(
    10,
    5,
    [Rectangle("wall", 4, 0, 1, 2)],
    [Body("robot", 1, 2.5, 0.4), Body("rock", 1, 1, 0.4)],
)


def of_pictures(*pictures: Any) -> Trace:
    built, network = evaluate.build("minisim", {"steps": 20}, "fully-meshed", {})
    simulator = Drawn(built.settings)
    simulator.pictures = list(pictures)
    return record(simulator, network, network.random(1, Stream(3)), 5)


@pytest.mark.parametrize(
    "pictures",
    [
        [FRAME, FRAME._replace(bodies=FRAME.bodies[:1])],
        [FRAME._replace(bodies=[]), FRAME],
        [
            FRAME,
            FRAME._replace(bodies=[Body("robot", float("nan"), 0, 0.4), FRAME.bodies[1]]),
        ],
        [FRAME._replace(width=0)],
        [FRAME._replace(places=[Rectangle("wall", float("inf"), 0, 1, 1)])],
        [FRAME, ValueError("no picture today")],
    ],
    ids=[
        "a body goes",
        "a body comes",
        "no place",
        "no field",
        "a place without an end",
        "it raises",
    ],
)
def test_frames_that_cannot_be_drawn_are_left_out_without_changing_the_trial(
    pictures: list[Any],
) -> None:
    """A plug-in's frames may be anything; fitness is what it is."""
    found = of_pictures(*pictures)
    assert list(found.frames) == []
    assert found.error == ""
    assert math.isfinite(found.fitness[0])
    assert found.no_picture == (
        "ValueError: no picture today" if isinstance(pictures[-1], Exception) else ""
    )
    header, tables = decoded(encode(found))
    assert "width" not in header
    assert set(tables) == {"inputs", "outputs", "hidden"}


class Raises(Minisim):
    """Its trial fails in the middle."""

    def step(self, actions: np.ndarray) -> Any:
        self.left = getattr(self, "left", 5) - 1
        if not self.left:
            raise RuntimeError(HOSTILE)
        return super().step(actions)


def test_a_failing_trial_is_shown_up_to_the_failure() -> None:
    built, network = evaluate.build("minisim", {"steps": 20}, "fully-meshed", {})
    found = record(Raises(built.settings), network, network.random(1, Stream(3)), 5)
    assert found.error == 'RuntimeError: </script><b>"\\x1b[31m'
    assert math.isnan(found.fitness[0])
    assert len(found.frames) == 5
    assert json.loads(decoded(encode(found))[0]["fitness"][0] or "null") is None
