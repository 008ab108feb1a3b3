"""Runs that end with an assessment: a noisy problem, whose servers this program is."""

import threading
from collections.abc import Generator, Iterator
from pathlib import Path
from zlib import crc32

import numpy as np
import pytest

from tests.ot.cluster.fake_connection import FakeConnection, result
from tests.repository import REPOSITORY
from zswarm import experiment
from zswarm.champion.controller import load_controller
from zswarm.errors import ConfigError
from zswarm.kernels.random import derive_seed
from zswarm.ot import run
from zswarm.ot.build import build
from zswarm.ot.cluster.events import Counted, Retracted
from zswarm.ot.logger import Generation, Logger, Result
from zswarm.ot.record.history_hash import History
from zswarm.ot.record.reader import Run
from zswarm.ot.record.results import finished_result
from zswarm.ot.record.rollback import go_back
from zswarm.ot.record.schema import ASSESSMENT
from zswarm.ot.record.writer import Record
from zswarm.ot.workload import Workload

TRIALS = 2


class Noisy(FakeConnection):
    """A trial's fitness is the first gene and noise, which genome and seed determine.

    Args:
        batch: trials that are counted at once.
    """

    def __init__(self, noise: float = 6.0, batch: int = 1000) -> None:
        super().__init__()
        self.noise, self.batch = noise, batch

    def play(self, workload: Workload) -> Iterator[Counted | Retracted]:
        trials = np.flatnonzero(~workload.counted)
        genes = [
            np.frombuffer(genome, "<f4")[0] if len(genome) % 4 == 0 else genome[-1] / 256
            for genome in workload.genomes
        ]
        for begin in range(0, len(trials), self.batch):
            part = trials[begin : begin + self.batch]
            who = workload.participants[part, 0]
            luck = [
                crc32(workload.genomes[one] + seed.tobytes()) / 2**32 - 0.5
                for one, seed in zip(who, workload.seeds[part], strict=True)
            ]
            workload.fitness[part, 0] = np.array(genes)[who] + self.noise * np.array(luck)
            workload.metrics[part] = 0.0
            workload.counted[part] = True
            yield Counted(part, "lab-1-0123abcd", 0.01)


def loaded(*overrides: str) -> experiment.Experiment:
    settings = ["generations=6", "optimizer.population=10", f"problem.trials={TRIALS}"]
    file = experiment.load(
        experiment.find("stadium"), [*settings, "assessment.budget=1", *overrides]
    )
    return experiment.complete(file, "test")


def begun(
    record: Record, complete: experiment.Experiment, servers: FakeConnection
) -> Generator[Generation, None, Result]:
    return run.evolve(build(complete), record, servers, Logger(), threading.Event())  # type: ignore[arg-type]


def evolved(out: Path, servers: FakeConnection, *overrides: str) -> tuple[Path, Result]:
    complete = loaded(*overrides)
    metrics = build(complete).problem.simulator.metrics
    with Record.create(out, complete, "0" * 32, metrics) as record:
        return record.folder, result(begun(record, complete, servers))


def resumed(folder: Path, servers: FakeConnection) -> Result:
    record, complete = Record.open(folder)
    with record:
        return result(begun(record, complete, servers))


def assessed(folder: Path) -> int:
    sql = "SELECT coalesce(sum(count), 0) FROM outcomes WHERE generation = ?"
    return Run(folder).rows(sql, tuple[int], ASSESSMENT)[0][0]


def test_the_champion_is_assessed_within_its_share_and_search_stays_as_it_is(
    tmp_path: Path,
) -> None:
    _, without = evolved(tmp_path / "off", Noisy(), "assessment.budget=0")
    assert (without.champion, without.assessment_hash) == (None, "")
    servers = Noisy()
    folder, whole = evolved(tmp_path / "on", servers)
    assert whole.history_hash == without.history_hash
    assert whole.best == without.best
    assert whole.evaluations == without.evaluations
    champion = whole.champion
    assert champion is not None
    assert champion.mean is not None
    assert champion.low is not None
    assert champion.low < champion.mean < (champion.high or 0.0)
    assert champion.mean < champion.in_search <= whole.best
    assert assessed(folder) == whole.evaluations * TRIALS
    assert champion.seeds == assessed(folder) // 4
    written = load_controller(folder)
    assert written.held_out == Run(folder).held_out == champion
    assert written.fitness == champion.in_search
    searched = [work for work in servers.handed if work.round == 0][:6]
    seeds = {seed for work in searched for seed in work.seeds.tolist()}
    later = servers.handed[len(searched) :]
    assert not seeds & {seed for work in later for seed in work.seeds.tolist()}
    race, held_out = later[:-1], later[-1]
    raced = {seed for work in race for seed in work.seeds.tolist()}
    assert not raced & set(held_out.seeds.tolist())
    Run(folder).check()
    assert finished_result(folder, loaded()) == whole._replace(
        run=str(folder), seconds=0.0
    )


def test_hash_and_champion_do_not_depend_on_batches_or_kept_genomes(
    tmp_path: Path,
) -> None:
    folder, whole = evolved(tmp_path / "one", Noisy())
    kept = ("record.genomes=best", "assessment.candidates=20")
    for batch, more in ((3, ()), (1000, kept)):
        _, other = evolved(tmp_path / f"by-{batch}", Noisy(batch=batch), *more)
        assert other.assessment_hash == whole.assessment_hash != ""
        assert other.champion == whole.champion
    assert Run(folder).meta["assessment_hash"] == whole.assessment_hash


class Killed(Exception):
    """The program ended here."""


class Dying(Noisy):
    """Servers whose run is killed in the middle of a round of its assessment."""

    def __init__(self, calls: int) -> None:
        super().__init__(batch=3)
        self.calls = calls

    def play(self, workload: Workload) -> Iterator[Counted | Retracted]:
        for item in super().play(workload):
            yield item
            if len(self.handed) == self.calls:
                raise Killed


def killed(out: Path, calls: int) -> Path:
    complete = loaded()
    with (
        Record.create(out, complete, "0" * 32, ["a", "b"]) as record,
        pytest.raises(Killed),
    ):
        result(begun(record, complete, Dying(calls)))
    return record.folder


@pytest.mark.parametrize("calls", [7, 8, 10, 16])
def test_a_run_killed_in_its_assessment_resumes_there(tmp_path: Path, calls: int) -> None:
    _, whole = evolved(tmp_path / "whole", Noisy())
    folder = killed(tmp_path, calls)
    assert 0 < assessed(folder) < assessed(tmp_path / "whole" / "stadium")
    assert not Run(folder).finished
    again = resumed(folder, Noisy())
    assert again.assessment_hash == whole.assessment_hash
    assert again.champion == whole.champion
    assert assessed(folder) == assessed(tmp_path / "whole" / "stadium")
    Run(folder).check()


def test_another_budget_begins_an_unfinished_assessment_again(tmp_path: Path) -> None:
    folder = killed(tmp_path, 10)
    file = folder / "experiment.toml"
    file.write_text(file.read_text().replace("budget = 1", "budget = 2"))
    again = resumed(folder, Noisy())
    assert assessed(folder) == 2 * again.evaluations * TRIALS
    _, whole = evolved(tmp_path / "whole", Noisy(), "assessment.budget=2")
    assert again.assessment_hash == whole.assessment_hash


def test_more_generations_are_assessed_anew_and_going_back_drops_it(
    tmp_path: Path,
) -> None:
    folder, first = evolved(tmp_path / "more", Noisy())
    file = folder / "experiment.toml"
    file.write_text(file.read_text().replace("generations = 6", "generations = 8"))
    longer = resumed(folder, Noisy())
    _, whole = evolved(tmp_path / "whole", Noisy(), "generations=8")
    assert longer.history_hash == whole.history_hash != first.history_hash
    assert longer.assessment_hash == whole.assessment_hash != first.assessment_hash
    go_back(folder, 8)
    assert assessed(folder) == 0
    assert Run(folder).held_out is None
    assert resumed(folder, Noisy()).assessment_hash == whole.assessment_hash


def test_nothing_is_assessed_where_trials_do_not_differ(tmp_path: Path) -> None:
    folder, ended = evolved(tmp_path / "two", Noisy(noise=0.0))
    assert ended.champion is None
    assert assessed(folder) == 0
    folder, ended = evolved(tmp_path / "one", Noisy(noise=0.0), "problem.trials=1")
    assert ended.champion is None
    assert assessed(folder) == 10  # trials of the best, which shows it
    _, ended = evolved(tmp_path / "noisy", Noisy(), "problem.trials=1")
    assert ended.champion is not None


def test_a_server_that_computes_wrong_is_uncounted_in_the_assessment(
    tmp_path: Path,
) -> None:
    folder, whole = evolved(tmp_path / "one", Noisy())
    complete = loaded()

    class Wrong(Noisy):
        """It evaluates half of a round of the race, before it is found out."""

        def play(self, workload: Workload) -> Iterator[Counted | Retracted]:
            if len(self.handed) == 9 and not workload.counted.any():
                part = np.arange(len(workload.seeds) // 2)
                workload.fitness[part], workload.metrics[part] = 99.0, 0.0
                workload.counted[part], workload.source[part] = True, "bad-1-0123abcd"
                yield Counted(part, "bad-1-0123abcd", 0.01)
                workload.retract("bad-1-0123abcd")
                yield Retracted("bad-1-0123abcd")
            yield from super().play(workload)

    with Record.create(tmp_path, complete, "0" * 32, ["a", "b"]) as record:
        ended = result(begun(record, complete, Wrong()))
    assert ended.assessment_hash == whole.assessment_hash
    assert assessed(record.folder) == assessed(folder)
    Run(record.folder).check()


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (
            ["assessment.budget=0.01"],
            "assessment: budget: 0.01 of the run's 120 simulations at most are fewer than a race "
            "of two candidates takes: expected 0.25 or more, or 0",
        ),
    ],
)
def test_a_budget_that_cannot_be_used_is_refused(
    overrides: list[str], words: str
) -> None:
    with pytest.raises(ConfigError) as refusal:
        build(loaded(*overrides))
    assert str(refusal.value) == words


def test_a_budget_for_a_game_is_refused() -> None:
    complete = experiment.complete(
        experiment.load(experiment.find("minisim-duel"), ["assessment.budget=0.1"]),
        "test",
    )
    with pytest.raises(ConfigError) as refusal:
        build(complete)
    assert str(refusal.value) == (
        "assessment: budget: expected 0, not 0.1: candidates play each other, so none has a "
        "fitness of its own"
    )


def test_the_document_gives_the_seeds_and_the_hash(tmp_path: Path) -> None:
    servers = Noisy()
    folder, ended = evolved(tmp_path, servers)
    first, *_, last = (work for work in servers.handed if work.generation == 6)
    for work, purpose in ((first, "assessment"), (last, "held-out")):
        seeds = [derive_seed(loaded().seed, purpose, n) for n in range(len(work.seeds))]
        assert work.seeds.tolist() == seeds
        assert (
            f'derive_seed(seed, "{purpose}", n)'
            in (REPOSITORY / "docs" / "noise.md").read_text()
        )
    outcomes: dict[int, list[float]] = {}
    for work in servers.handed[6:-1]:
        for who, fitness in zip(work.participants[:, 0], work.fitness[:, 0], strict=True):
            outcomes.setdefault(int(who), []).append(float(fitness))
    fitness = [value for who in sorted(outcomes) for value in outcomes[who]]
    history = History(bytes.fromhex(ended.history_hash))
    history.add(first.genomes, np.array([*fitness, *last.fitness[:, 0]]))
    assert history.hex() == ended.assessment_hash == Run(folder).meta["assessment_hash"]
