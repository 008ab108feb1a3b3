"""A generation whose candidates play each other: round after round, resumed anywhere, told once."""

import sqlite3
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.ot.cluster.fake_connection import FakeConnection, result
from zswarm import experiment
from zswarm.champion.controller import Controller, load_controller
from zswarm.config.sections import PartConfig
from zswarm.errors import ConfigError, Stopped
from zswarm.ot import run
from zswarm.ot.build import build
from zswarm.ot.cluster.events import Counted, Retracted
from zswarm.ot.generation import Assessment
from zswarm.ot.logger import Generation, Logger, Result
from zswarm.ot.optimizers.nnga import NNGA
from zswarm.ot.record.reader import Run
from zswarm.ot.record.writer import Record
from zswarm.ot.workload import Workload
from zswarm.plugins import registry as plugins

GENERATIONS, POPULATION, TRIALS = 3, 7, 2


class Players(FakeConnection):
    """A participant's fitness is its first gene; some trials at a time."""

    def __init__(self, at_once: int = 5, stop_after: int | None = None) -> None:
        super().__init__()
        self.at_once, self.left = at_once, stop_after
        # The genomes of each trial, and its seed.
        self.played: list[tuple[bytes, ...]] = []
        self.fitness = "genes"
        # A round of a generation, counted from the first handed out.
        self.retract_in: tuple[int, int] | None = None

    def play(self, workload: Workload) -> Iterator[Counted | Retracted]:
        genes = np.array(
            [np.frombuffer(genome, "<f4")[0] for genome in workload.genomes], np.float64
        )
        while len(waiting := np.flatnonzero(~workload.counted)):
            trials = waiting[: self.at_once]
            if self.left is not None:
                if self.left < len(trials):
                    raise Stopped("stopped")
                self.left -= len(trials)
            participants = workload.participants[trials]
            workload.fitness[trials] = (
                genes[participants] if self.fitness == "genes" else np.nan
            )
            workload.metrics[trials] = participants.sum(axis=1)[:, None] * [1.0, 2.0, 3.0]
            workload.counted[trials], workload.source[trials] = True, "lab-1"
            for players, seed in zip(participants, workload.seeds[trials], strict=True):
                self.played.append(
                    (*(workload.genomes[player] for player in players), seed.tobytes())
                )
            yield Counted(trials, "lab-1", 0.01)
            if self.retract_in == (workload.round, int(workload.counted.sum())):
                self.retract_in = None
                workload.retract("lab-1")
                yield Retracted("lab-1")


@pytest.fixture
def servers() -> Players:
    return Players()


def loaded(*overrides: str) -> experiment.Experiment:
    settings = [
        f"generations={GENERATIONS}",
        f"optimizer.population={POPULATION}",
        f"problem.trials={TRIALS}",
    ]
    return experiment.complete(
        experiment.load(experiment.find("minisim-duel"), [*settings, *overrides]), "test"
    )


def evolved(
    parent: Path,
    complete: experiment.Experiment,
    servers: Players,
    logger: Logger | None = None,
) -> tuple[Path, Result]:
    parts = build(complete)
    with Record.create(
        parent, complete, "0" * 32, parts.problem.simulator.metrics, relative=1
    ) as record:
        return record.folder, followed(parts, record, servers, logger)


def followed(
    parts: run.Parts, record: Record, servers: Players, logger: Logger | None = None
) -> Result:
    return result(
        run.evolve(parts, record, servers, logger or Logger(), threading.Event())
    )  # type: ignore[arg-type]


def rows(folder: Path, sql: str) -> list[tuple[Any, ...]]:
    database = sqlite3.connect(folder / "run.sqlite")
    try:
        return database.execute(sql).fetchall()
    finally:
        database.close()


def test_a_generation_plays_its_rounds_and_the_optimizer_gets_scores(
    tmp_path: Path, servers: Players
) -> None:
    """Three pairs of seven play in each of three rounds; the greatest gene wins all its games."""
    folder, _ = evolved(tmp_path, loaded(), servers)
    assert [
        (workload.round, workload.first, len(workload.seeds))
        for workload in servers.handed
    ] == [
        (round_, 3 * TRIALS * round_, 3 * TRIALS)
        for _ in range(GENERATIONS)
        for round_ in range(3)
    ]
    for generation in range(GENERATIONS):
        candidates = Run(folder).candidates(generation)
        genes = [np.frombuffer(candidate["genome"], "<f4")[0] for candidate in candidates]
        scores = [candidate["fitness"] for candidate in candidates]
        assert scores[int(np.argmax(genes))] == max(scores)
        assert sum(scores) == 3 * (3 * 2 + 2), "three wins and a bye in each round"
    first = servers.handed[0].participants
    assert first.tolist() == [[0, 6], [0, 6], [1, 5], [1, 5], [2, 4], [2, 4]]


def test_the_next_generation_is_sent_before_this_one_is_reported(
    tmp_path: Path, servers: Players
) -> None:
    told: list[int] = []

    class Watching(Logger):
        def on_generation(self, generation: Generation) -> None:  # noqa: ARG002
            told.append(len(servers.handed))

    evolved(tmp_path, loaded(), servers, Watching())
    assert told == [4, 7, 9]


@pytest.mark.parametrize("stop_after", [0, 3, 5, 6, 9, 12, 17, 18, 20, 30, 53])
def test_a_run_stopped_in_any_round_has_the_same_result(
    tmp_path: Path, servers: Players, stop_after: int
) -> None:
    """No recorded trial is played again, and the history is the same."""
    complete = loaded()
    _, whole = evolved(tmp_path / "whole", complete, servers)
    stopping = Players(at_once=3, stop_after=stop_after)
    with pytest.raises(Stopped):
        evolved(tmp_path / "stopped", complete, stopping)
    resuming = Players(at_once=2)
    record, complete = Record.open(tmp_path / "stopped" / "minisim-duel")
    with record:
        resumed = followed(build(complete), record, resuming)
        history = record.history().hex()
    assert resumed.history_hash == history == whole.history_hash
    assert sorted(stopping.played + resuming.played) == sorted(servers.played)


def test_the_record_has_the_players_of_each_trial(
    tmp_path: Path, servers: Players
) -> None:
    folder, _ = evolved(tmp_path, loaded(), servers)
    found = rows(
        folder,
        "SELECT generation, round, count, trials, participants, fitness FROM outcomes ORDER BY id",
    )
    seen: dict[int, list[int]] = {}
    for generation, round_, count, trials, participants, fitness in found:
        workload = servers.handed[3 * generation + round_]
        indices = np.frombuffer(trials, "<u4")
        seen.setdefault(generation, []).extend(indices.tolist())
        games = np.frombuffer(participants, "<u4").reshape(count, 2)
        assert games.tolist() == workload.participants[indices - workload.first].tolist()
        assert (
            np.frombuffer(fitness, "<f8").reshape(count, 2).tolist()
            == workload.fitness[indices - workload.first].tolist()
        )
    assert seen == {generation: list(range(18)) for generation in range(GENERATIONS)}
    read = Run(folder).trials(1)
    assert [(trial["game"], trial["trial"]) for trial in read] == [
        (game, trial) for game in range(9) for trial in range(2)
    ]
    together = np.concatenate([workload.participants for workload in servers.handed[3:6]])
    assert [trial["candidates"] for trial in read] == together.tolist()


def test_outcomes_of_a_wrong_server_are_dropped_and_earlier_rounds_are_marked(
    tmp_path: Path, servers: Players
) -> None:
    """The games of a round were paired by what came before: those rounds stay, marked."""
    _, whole = evolved(tmp_path / "whole", loaded(), servers)
    servers.handed.clear()
    servers.retract_in = (1, 5)
    folder, told = evolved(tmp_path / "wrong", loaded(), servers)
    assert told.history_hash == whole.history_hash
    sums = (
        "SELECT generation, round, sum(count), max(doubtful) FROM outcomes GROUP BY 1, 2"
    )
    assert rows(folder, sums)[:3] == [(0, 0, 6, 1), (0, 1, 6, 0), (0, 2, 6, 0)]
    assert told.doubtful == 6


def test_outcomes_of_other_games_are_refused(tmp_path: Path, servers: Players) -> None:
    """Another ranking's code pairs otherwise: what was recorded is of other candidates."""
    complete = loaded()
    servers.left = 3
    servers.at_once = 3
    with pytest.raises(Stopped):
        evolved(tmp_path, complete, servers)
    record, complete = Record.open(tmp_path / "minisim-duel")
    parts = build(complete)
    with record:
        workload = Assessment(parts.problem, parts.optimizer.ask(), 0).workload
        workload.participants = workload.participants[:, ::-1].copy()
        record.begin(0, workload)
        with pytest.raises(ConfigError, match="was begun with other candidates or games"):
            record.restore(workload)


def test_the_champion_is_the_best_of_the_last_generation(
    tmp_path: Path, servers: Players
) -> None:
    """It is replaced in every generation, also by one with fewer points."""
    champions: list[Controller] = []

    class Watching(Logger):
        def on_champion(self, champion: Controller) -> None:
            champions.append(champion)

    folder, told = evolved(tmp_path, loaded(), servers, Watching())
    assert len(champions) == GENERATIONS
    recorded = Run(folder)
    for generation, champion in enumerate(champions):
        scores = [
            (candidate["fitness"], candidate["genome"])
            for candidate in recorded.candidates(generation)
        ]
        assert (
            champion.fitness
            == max(score for score, _ in scores)
            == recorded.history()[generation]["best"]
        )
        assert (champion.fitness, champion.genome) in scores
    assert load_controller(folder).genome == champions[-1].genome
    assert (told.best, recorded.best()) == (champions[-1].fitness, champions[-1].fitness)
    listed = rows(folder, "SELECT generation, best FROM champions")
    assert listed == [
        (generation, champion.fitness) for generation, champion in enumerate(champions)
    ]


def test_a_generation_in_which_all_games_fail_has_no_champion_and_ends_nothing(
    tmp_path: Path, servers: Players
) -> None:
    servers.fitness = "nothing"
    folder, told = evolved(tmp_path, loaded(), servers)
    assert told.best == -np.inf
    assert not (folder / "champion.zsc").exists()
    assert [candidate["fitness"] for candidate in Run(folder).candidates(1)] == [
        None
    ] * POPULATION


def test_measures_of_a_candidate_are_means_over_all_its_games(
    tmp_path: Path, servers: Players
) -> None:
    """The stand-in's metrics are the sum of a game's candidates, once, twice and three times."""
    assessment = Assessment(
        build(loaded()).problem, [bytes([1, 0, 0, number]) * 76 for number in range(7)], 0
    )
    opponents: dict[int, list[int]] = {candidate: [] for candidate in range(7)}
    while True:
        list(servers.evaluate(assessment.workload))
        for one, other in assessment.workload.participants.tolist():
            opponents[one].append(one + other)
            opponents[other].append(one + other)
        if not assessment.advance():
            break
    expected = [
        [3 * np.mean(opponents[candidate]), np.mean(opponents[candidate])]
        for candidate in range(7)
    ]
    assert assessment.measures(["tagged", "captures"]) == pytest.approx(
        np.array(expected)
    )


class Alone(NNGA):
    """Evolve like NNGA, but take no relative fitness."""

    competes = False


def test_an_optimizer_that_compares_generations_is_refused_with_those_that_do_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(plugins.BUNDLED["optimizer"], "alone", f"{__name__}:Alone")
    plugins._installed.cache_clear()
    try:
        with pytest.raises(ConfigError) as refusal:
            build(loaded("optimizer.kind=alone"))
    finally:
        monkeypatch.undo()
        plugins._installed.cache_clear()
    refused = str(refusal.value)
    assert refused.startswith("optimizer: alone compares fitness between generations")
    assert "nnga" in refused
    assert "alone" not in refused.partition("optimizers that take them: ")[2]


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (
            ["ranking.kind=absolute", "--"],
            "ranking: absolute judges each candidate by itself, and this problem is a game of 2",
        ),
        (
            ["ranking.kind=swis"],
            "unknown ranking 'swis' (did you mean 'swiss'?); known are: absolute, full-tournament",
        ),
        (["ranking.round=3"], "unknown key 'round' (did you mean 'rounds'?)"),
        (
            ["problem.settings.teams=1"],
            "ranking: a tournament needs a problem of several participants",
        ),
    ],
)
def test_incompatible_parts_are_refused_in_one_line(
    overrides: list[str], words: str
) -> None:
    overrides = ["ranking = { kind = 'absolute' }"] if "--" in overrides else overrides
    with pytest.raises(ConfigError) as refusal:
        build(loaded(*overrides))
    assert words in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_the_record_of_a_file_without_a_ranking_has_no_ranking(
    tmp_path: Path,
) -> None:
    """Runs from before rankings can be resumed; a ranking added since is a change."""
    complete = experiment.complete(experiment.load(experiment.find("stadium")), "test")
    with Record.create(tmp_path, complete, "0" * 32) as record:
        assert "ranking" not in record.meta("experiment")
        assert Run(record.folder).experiment.ranking == PartConfig(
            kind="absolute", settings={}
        )
        file = record.folder / "experiment.toml"
        text = file.read_text()
        assert '[ranking]\nkind = "absolute"\n' in text
    file.write_text(text.replace('[ranking]\nkind = "absolute"\n', ""))
    Record.open(record.folder)[0].close()
    file.write_text(text.replace('kind = "absolute"', 'kind = "swiss"'))
    with pytest.raises(ConfigError, match="ranking changed since the run began"):
        Record.open(record.folder)
    assert Run(record.folder).changed == ["ranking"]
