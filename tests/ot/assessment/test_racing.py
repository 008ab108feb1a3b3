"""Trials of candidates that will hardly survive stop, decided by outcomes alone."""

import contextlib
import threading
from collections.abc import Generator, Iterator
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from tests.ot.assessment.test_assessed_runs import Noisy
from tests.ot.cluster.fake_connection import FakeConnection, result
from tests.ot.optimizers.test_fresh_seeds import SETTINGS
from zswarm import experiment
from zswarm.errors import ConfigError
from zswarm.ot import run
from zswarm.ot.assessment import racing
from zswarm.ot.build import build
from zswarm.ot.cluster.events import Counted, Retracted
from zswarm.ot.logger import Generation, Logger, Result
from zswarm.ot.record.reader import Run
from zswarm.ot.record.writer import Record
from zswarm.ot.workload import Workload
from zswarm.plugins import registry

TRIALS, GENERATIONS = 10, 4


def loaded(*overrides: str) -> experiment.Experiment:
    settings = [
        f"generations={GENERATIONS}",
        f"problem.trials={TRIALS}",
        "problem.settings.seed=-1",
        "optimizer.population=20",
        "assessment.racing=true",
        "assessment.budget=0",
        *overrides,
    ]
    file = experiment.load(experiment.find("stadium"), settings)
    return experiment.complete(file, "test")


def begun(record: Record, servers: FakeConnection) -> Generator[Generation, None, Result]:
    parts = build(experiment.complete(Run(record.folder).experiment, "test"))
    return run.evolve(parts, record, servers, Logger(), threading.Event())  # type: ignore[arg-type]


def new(out: Path, *overrides: str) -> Record:
    complete = loaded(*overrides)
    metrics = build(complete).problem.simulator.metrics
    return Record.create(out, complete, "0" * 32, metrics)


def evolved(out: Path, servers: FakeConnection, *overrides: str) -> tuple[Path, Result]:
    with new(out, *overrides) as record:
        return record.folder, result(begun(record, servers))


def stopped(out: Path, *overrides: str, servers: FakeConnection | None = None) -> Path:
    """Evolve two generations."""
    with (
        new(out, *overrides) as record,
        contextlib.closing(begun(record, servers or Noisy())) as evolution,
    ):
        for _ in islice(evolution, 2):
            pass
        return record.folder


def resumed(folder: Path, servers: FakeConnection) -> Result:
    record, _ = Record.open(folder)
    with record:
        return result(begun(record, servers))


def played(folder: Path) -> int:
    sql = "SELECT sum(count) FROM outcomes WHERE generation < ?"
    return Run(folder).rows(sql, tuple[int], GENERATIONS)[0][0]


# ---- the rule


@pytest.mark.parametrize(
    ("trials", "ends"),
    [
        (3, [2, 3]),
        (6, [2, 3, 4, 6]),
        (10, [2, 4, 6, 8, 10]),
        (100, [20, 40, 60, 80, 100]),
    ],
)
def test_trials_are_played_in_at_most_five_rounds(trials: int, ends: list[int]) -> None:
    assert racing.rounds(trials) == ends


def test_who_is_a_standard_error_behind_the_last_survivor_stops() -> None:
    """Means 5, 4, 3 and 0; residuals are 1 or -1, so the error is sqrt(2 * 8 / 3 / 2) = 1.63."""
    means, noise = np.array([0.0, 5.0, 4.0, 3.0]), np.array([[1, -1], [-1, 1]] * 2)
    fitness = means[:, None] + noise
    assert racing.remaining(fitness, 1).tolist() == [False, True, True, False]
    assert racing.remaining(fitness, 2).tolist() == [False, True, True, True]
    assert racing.remaining(fitness, 4).all()
    # A trial that is harder for all is no noise; one that failed has failed.
    harder = fitness + np.array([0.0, 1000.0])
    assert racing.remaining(harder, 1).tolist() == [False, True, True, False]
    fitness[1, 0] = np.nan
    assert racing.remaining(fitness, 1).tolist() == [False, False, True, True]


def test_equal_outcomes_stop_nobody_and_certain_ones_all_that_are_worse() -> None:
    assert racing.remaining(np.ones((5, 2)), 1).all()
    ranked = np.repeat(np.arange(5.0)[:, None], 2, axis=1)
    assert racing.remaining(ranked, 2).tolist() == [False] * 3 + [True] * 2


def test_who_stopped_stays_as_far_behind_and_never_overtakes() -> None:
    nan = np.nan
    fitness = np.array([[3, 3, 1, 1], [5, 5, 1, 3], [2, 2, nan, nan], [9, 9, nan, nan]])
    numbers = np.array([4, 4, 2, 2])
    # On two trials the whole ones have 8 in the mean, on four 11: 4 behind on two, 8 on four.
    assert racing.totals(fitness, numbers).tolist() == [8.0, 14.0, 3.0, 8.0]
    fitness[2, 1] = nan  # failed
    np.testing.assert_array_equal(racing.totals(fitness, numbers), [8, 14, nan, 8])
    fitness[:2, 3] = nan
    np.testing.assert_array_equal(racing.totals(fitness, numbers), [nan, nan, nan, 36])


# ---- a run


def test_racing_saves_trials_and_finds_the_same_kind_of_best(tmp_path: Path) -> None:
    servers = Noisy(noise=0.5)
    folder, ended = evolved(tmp_path / "raced", servers)
    assert played(folder) < 0.7 * ended.evaluations * TRIALS
    for generation in range(GENERATIONS):
        rows, trials = Run(folder).candidates(generation), Run(folder).trials(generation)
        counts = np.bincount([trial["candidate"] for trial in trials])
        seeds = [trial["trial"] for trial in trials]
        assert set(counts.tolist()) <= {2, 4, 6, 8, 10}
        assert len(counts) == len(rows)
        whole = [row["fitness"] for row, n in zip(rows, counts, strict=True) if n == 10]
        stopped = [row["fitness"] for row, n in zip(rows, counts, strict=True) if n < 10]
        assert len(whole) >= 5, "elite and survivors of nnga"
        assert max(stopped) <= min(whole)
        sums = dict.fromkeys(range(len(rows)), 0.0)
        for trial in trials:
            sums[trial["candidate"]] += trial["fitness"][0]
        for number, row in enumerate(rows):
            if counts[number] == 10:
                assert row["fitness"] == pytest.approx(sums[number])
        assert max(seeds) == TRIALS - 1
    first = servers.handed[0]
    assert len(first.seeds) == 2 * 20
    assert [work.round for work in servers.handed[:5]] == [0, 1, 2, 3, 4]
    Run(folder).check()


def test_without_racing_the_history_is_as_it_was(tmp_path: Path) -> None:
    _, off = evolved(tmp_path / "off", Noisy(), "assessment.racing=false")
    _, on = evolved(tmp_path / "on", Noisy())
    assert off.history_hash != on.history_hash
    folder = tmp_path / "off" / "stadium"
    assert "racing" not in Run(folder).meta["experiment"]
    assert played(folder) == off.evaluations * TRIALS


@pytest.mark.parametrize("kind", ["nnga", "cmaes", "random"])
@pytest.mark.parametrize("seeds", ["fixed", "fresh"])
def test_the_history_does_not_depend_on_batches_or_on_where_it_was_resumed(
    tmp_path: Path, kind: str, seeds: str
) -> None:
    more = (f"optimizer.kind={kind}", f"problem.seeds={seeds}")
    folder, whole = evolved(tmp_path / "whole", Noisy(), *more)
    assert played(folder) < whole.evaluations * TRIALS
    _, other = evolved(tmp_path / "batches", Noisy(batch=3), *more)
    assert other.history_hash == whole.history_hash
    again = stopped(tmp_path / "stopped", *more)
    assert resumed(again, Noisy()).history_hash == whole.history_hash
    assert played(again) == played(folder)


class Killed(Exception):
    """The program ended here."""


class Dying(Noisy):
    """Servers whose run is killed in the middle of a round; one of them computes wrong before."""

    def __init__(self, calls: int) -> None:
        super().__init__(batch=3)
        self.calls = calls

    def play(self, workload: Workload) -> Iterator[Counted | Retracted]:
        if len(self.handed) == self.calls and len(workload.seeds) > 1:
            part = np.array([0])
            workload.fitness[part], workload.metrics[part] = 99.0, 0.0
            workload.counted[part], workload.source[part] = True, "bad-1-0123abcd"
            yield Counted(part, "bad-1-0123abcd", 0.01)
            workload.retract("bad-1-0123abcd")
            yield Retracted("bad-1-0123abcd")
        for item in super().play(workload):
            yield item
            if len(self.handed) == self.calls:
                raise Killed


@pytest.mark.parametrize("calls", [1, 2, 4, 5, 6, 7, 9, 14])
def test_a_run_killed_in_a_round_resumes_there(tmp_path: Path, calls: int) -> None:
    folder, whole = evolved(tmp_path / "whole", Noisy())
    with pytest.raises(Killed):
        evolved(tmp_path / "killed", Dying(calls))
    killed = tmp_path / "killed" / "stadium"
    assert 0 < played(killed) < played(folder)
    assert resumed(killed, Noisy()).history_hash == whole.history_hash
    assert played(killed) == played(folder), "no trial is played twice"
    Run(killed).check()


def test_the_assessment_takes_a_share_of_the_trials_that_were_played(
    tmp_path: Path,
) -> None:
    folder, ended = evolved(tmp_path, Noisy(), "assessment.budget=0.5")
    assert ended.champion is not None
    sql = "SELECT sum(count) FROM outcomes WHERE generation > ?"
    assert Run(folder).rows(sql, tuple[int], GENERATIONS)[0][0] == played(folder) // 2


def test_racing_cannot_be_changed_while_a_run_is_stopped(tmp_path: Path) -> None:
    folder = stopped(tmp_path)
    file = folder / "experiment.toml"
    file.write_text(file.read_text().replace("racing = true", "racing = false"))
    with pytest.raises(ConfigError, match=r"assessment\.racing changed since the run"):
        Record.open(folder)
    assert Run(folder).changed == ["assessment.racing"]
    assert Run(folder).experiment.assessment.racing


# ---- what cannot be raced


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (
            ["problem.trials=1"],
            "assessment: racing: expected problem.trials of at least 3, not 1: with fewer there is "
            "nothing to stop",
        ),
        (
            ["optimizer.kind=cuckoo"],
            "assessment: racing: expected an optimizer that uses the order of fitness only, such "
            "as nnga with one island, cmaes or random: cuckoo needs the fitness of all candidates "
            "with these settings",
        ),
        (
            ["optimizer.islands=2"],
            "assessment: racing: expected an optimizer that uses the order of fitness only, such "
            "as nnga with one island, cmaes or random: nnga needs the fitness of all candidates "
            "with these settings",
        ),
        (
            ["problem.seeds=fresh", "problem.settings.seed=7"],
            'problem: seeds: expected "fixed": emergency-exit determines the seeds of its trials '
            "with these settings (`zswarm-ot describe` explains which)",
        ),
    ],
)
def test_what_cannot_be_raced_is_refused_in_one_line(
    overrides: list[str], words: str
) -> None:
    with pytest.raises(ConfigError) as refusal:
        build(loaded(*overrides))
    assert str(refusal.value) == words


def test_games_cannot_be_raced() -> None:
    file = experiment.load(experiment.find("minisim-duel"), ["assessment.racing=true"])
    with pytest.raises(ConfigError) as refusal:
        build(experiment.complete(file, "test"))
    assert str(refusal.value) == (
        "assessment: racing: expected false: candidates play each other, so none has a fitness of "
        "its own"
    )


def test_the_refusal_names_the_optimizers_that_can_be_raced() -> None:
    able = set()
    for kind in registry.names("optimizer"):
        mapping = experiment.to_mapping(loaded())
        mapping["optimizer"] = {"kind": kind, **SETTINGS.get(kind, {})}
        if kind == "neat":
            mapping["representation"] = {"kind": "neat"}
        complete = experiment.complete(experiment.check(mapping, "test"), "test")
        with contextlib.suppress(ConfigError):
            build(complete)
            able.add(kind)
    assert able == {"nnga", "cmaes", "random"}
