"""The loop of a run: while a generation is recorded and told, servers have the next one."""

import shutil
import threading
from collections.abc import Generator, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from tests.ot.cluster.fake_connection import FakeConnection, result
from zswarm import experiment
from zswarm.errors import ConfigError, Stopped
from zswarm.nets.representation import Representation
from zswarm.ot import run
from zswarm.ot.build import build
from zswarm.ot.cluster.events import Counted
from zswarm.ot.evolution import Requests
from zswarm.ot.generation import Assessment
from zswarm.ot.logger import Generation, Logger, Result
from zswarm.ot.notes import Note, RunEvent
from zswarm.ot.optimizers.cmaes import CMAES
from zswarm.ot.optimizers.nnga import NNGA, NNGASettings
from zswarm.ot.optimizers.optimizer import Told
from zswarm.ot.record import control_file
from zswarm.ot.record.history_hash import History
from zswarm.ot.record.reader import Run
from zswarm.ot.record.writer import Record
from zswarm.ot.workload import Workload
from zswarm.plugins import registry as plugins


class MeasuringSettings(
    NNGASettings, frozen=True, kw_only=True, forbid_unknown_fields=True
):
    """Add names of metrics to the settings of NNGA."""

    measures: tuple[str, ...] = ()


class Measuring(NNGA):
    """NNGA that is told measures, too, and keeps them."""

    settings_type = MeasuringSettings
    settings: MeasuringSettings

    def __init__(
        self, settings: MeasuringSettings, representation: Representation, seed: int
    ) -> None:
        super().__init__(settings, representation, seed)
        self.measures = settings.measures
        self.told: list[np.ndarray] = []

    def _tell(self, fitness: np.ndarray, measures: np.ndarray) -> None:
        super()._tell(fitness, measures)
        self.told.append(measures)

    def restore(self, state: Mapping[str, Any], told: Iterable[Told]) -> None:
        super().restore(state, told)
        self.told = [generation.measures for generation in told]


class Genes(FakeConnection):
    """A candidate's fitness is its first gene, the same for each of its trials."""

    def play(self, workload: Workload) -> Iterator[Counted]:
        trials = np.flatnonzero(~workload.counted)
        genes = np.array([np.frombuffer(genome, "<f4")[0] for genome in workload.genomes])
        workload.fitness[trials] = genes[workload.participants[trials]]
        workload.metrics[trials] = np.stack(
            [workload.seeds[trials] % 7 / 3, workload.fitness[trials, 0]], axis=1
        )
        workload.counted[trials] = True
        yield Counted(trials, "lab-1-0123abcd", 0.01)


class Continuing(FakeConnection):
    """A run's servers, which take back the request to pause once the run pauses."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.folder = folder

    def pause(self, *, paused: bool) -> None:
        super().pause(paused=paused)
        control_file.forget(self.folder)


def test_a_run_that_pauses_gives_its_slots_back_until_it_continues(
    tmp_path: Path,
) -> None:
    servers, stop = Continuing(tmp_path), threading.Event()
    requests = Requests(tmp_path, Logger(), stop)
    requests.obey(servers)  # type: ignore[arg-type]
    assert servers.pauses == []
    control_file.ask(tmp_path, "pause")
    requests.obey(servers)  # type: ignore[arg-type]
    assert servers.pauses == [True, False]
    control_file.ask(tmp_path, "drain")
    with pytest.raises(Stopped):
        requests.obey(servers)  # type: ignore[arg-type]


@pytest.fixture
def servers() -> Genes:
    return Genes()


def begun(
    record: Record, complete: experiment.Experiment, servers: Genes
) -> Generator[Generation, None, Result]:
    return run.evolve(build(complete), record, servers, Logger(), threading.Event())  # type: ignore[arg-type]


def loaded(*overrides: str) -> experiment.Experiment:
    settings = ["generations=4", "optimizer.population=10", *overrides]
    return experiment.complete(
        experiment.load(experiment.find("stadium"), settings), "test"
    )


def created(out: Path, complete: experiment.Experiment) -> Record:
    return Record.create(
        out, complete, "0" * 32, build(complete).problem.simulator.metrics
    )


def test_a_generation_is_recorded_after_its_report_and_the_next_is_sent(
    tmp_path: Path, servers: Genes
) -> None:
    complete = loaded()
    with created(tmp_path, complete) as record:
        evolution = begun(record, complete, servers)
        for generation in range(4):
            told = next(evolution)
            record.sync()
            assert told.generation == generation
            assert [row["generation"] for row in Run(record.folder).history()] == list(
                range(generation + 1)
            )
            assert told.evaluations == sum(
                len(workload.genomes) for workload in servers.handed[: generation + 1]
            )
            assert len(servers.handed) == min(generation + 2, 4)
        assert result(evolution).history_hash == record.history().hex()


def with_cmaes(*overrides: str) -> experiment.Experiment:
    mapping = experiment.to_mapping(loaded(*overrides)) | {
        "optimizer": {"kind": "cmaes", "population": 10}
    }
    return experiment.complete(experiment.check(mapping, "test"), "test")


@pytest.mark.parametrize("complete", [loaded(), with_cmaes()], ids=["nnga", "cmaes"])
def test_a_run_abandoned_in_its_loop_resumes_with_the_same_result(
    tmp_path: Path, servers: Genes, complete: experiment.Experiment
) -> None:
    """Nothing is recorded of the generation that servers had by then; it is asked for again."""
    with created(tmp_path / "whole", complete) as record:
        whole = result(begun(record, complete, servers))
    with created(tmp_path / "left", complete) as record:
        evolution = begun(record, complete, servers)
        for _ in range(2):
            next(evolution)
        evolution.close()
    left = servers.handed[-1].genomes
    record, complete = Record.open(record.folder)
    with record:
        assert record.resumed().generation == 2
        assert record.evaluations() == 10 + len(servers.handed[-2].genomes)
        resumed = result(begun(record, complete, servers))
    assert (resumed.history_hash, resumed.evaluations) == (
        whole.history_hash,
        whole.evaluations,
    )
    assert servers.handed[-2].genomes == left


def test_a_finished_run_requests_no_evaluations(tmp_path: Path, servers: Genes) -> None:
    complete = loaded()
    with created(tmp_path, complete) as record:
        first = result(begun(record, complete, servers))
    record, complete = Record.open(record.folder)
    with record:
        again = result(begun(record, complete, servers))
    assert len(servers.handed) == 4
    assert (again.history_hash, again.evaluations) == (
        first.history_hash,
        first.evaluations,
    )


@pytest.mark.parametrize(("islands", "trials", "slots"), [(1, 1, 10), (3, 2, 60)])
def test_slots_are_wanted_for_the_candidates_of_all_islands(
    tmp_path: Path, servers: Genes, islands: int, trials: int, slots: int
) -> None:
    complete = loaded(
        f"optimizer.islands={islands}", f"problem.trials={trials}", "generations=1"
    )
    with created(tmp_path, complete) as record:
        result(begun(record, complete, servers))
    assert servers.asked["slots"] == slots


def test_generations_are_written_together_and_each_as_a_whole(
    tmp_path: Path, servers: Genes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Their outcomes, too; nothing is read in the loop."""
    complete = loaded("generations=4")
    monkeypatch.setattr("zswarm.ot.record.commits.COMMIT_S", 3600.0)
    monkeypatch.setattr("zswarm.ot.record.commits.UNSYNCED_S", 3600.0)
    with created(tmp_path, complete) as record:
        evolution = begun(record, complete, servers)
        next(evolution)
        record.sync()
        statements: list[str] = []
        record._database._connection.set_trace_callback(statements.append)
        next(evolution)
        next(evolution)
        assert statements == []
        record.sync()
        assert [line for line in statements if line.startswith(("BEGIN", "COMMIT"))] == [
            "BEGIN IMMEDIATE",
            "COMMIT",
        ]
        assert sum("INTO generations" in line for line in statements) == 2
        assert not [line for line in statements if line.startswith("SELECT")]
        evolution.close()


def test_a_killed_run_that_lost_reported_generations_has_the_same_result(
    tmp_path: Path, servers: Genes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What was reported a moment before a kill may not be recorded: it is evaluated again."""
    complete = loaded("generations=5")
    with created(tmp_path / "whole", complete) as record:
        whole = result(begun(record, complete, servers))
    with created(tmp_path / "killed", complete) as record:
        evolution = begun(record, complete, servers)
        next(evolution)
        record.sync()
        monkeypatch.setattr("zswarm.ot.record.commits.COMMIT_S", 3600.0)
        monkeypatch.setattr("zswarm.ot.record.commits.UNSYNCED_S", 3600.0)
        for _ in range(3):
            next(evolution)
        killed = shutil.copytree(record.folder, tmp_path / "as-killed")
        evolution.close()
    monkeypatch.undo()
    record, complete = Record.open(killed)
    with record:
        assert record.resumed().generation == 1
        again = result(begun(record, complete, servers))
    assert (again.history_hash, again.evaluations) == (
        whole.history_hash,
        whole.evaluations,
    )


class Said(Logger):
    """Keep the lines for the user."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def on_say(self, line: str) -> None:
        self.lines.append(line)


def test_diverging_proposals_are_reported_and_the_run_continues(
    tmp_path: Path, servers: Genes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Draws may differ on another processor or version, here from generation 2 on."""
    complete = with_cmaes()
    with created(tmp_path, complete) as record:
        evolution = begun(record, complete, servers)
        for _ in range(3):
            next(evolution)
        evolution.close()
    propose = CMAES._propose
    monkeypatch.setattr(
        CMAES,
        "_propose",
        lambda self: propose(self) + (0.1 if self.generation >= 2 else 0.0),
    )
    record, complete = Record.open(record.folder)
    said = Said()
    with record:
        record.begin(3, servers.handed[-1])
        for counted in servers.play(servers.handed[-1]):
            record.add(counted, servers.handed[-1])
        ended = result(
            run.evolve(build(complete), record, servers, said, threading.Event())
        )  # type: ignore[arg-type]
    assert said.lines[1:] == [
        "cmaes would have proposed other candidates from generation 3 on; "
        "it continues from the recorded ones",
        "generation 4 was begun with other candidates: 10 trials are dropped",
    ]
    assert ended.evaluations == 40
    genomes = [
        [row["genome"] for row in Run(record.folder).candidates(generation)]
        for generation in range(4)
    ]
    assert genomes[:3] == [workload.genomes for workload in servers.handed[:3]]
    assert genomes[3] == servers.handed[-1].genomes != servers.handed[3].genomes


@pytest.fixture
def measuring(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setitem(
        plugins.BUNDLED["optimizer"], "measuring", f"{__name__}:Measuring"
    )
    plugins._installed.cache_clear()
    yield
    plugins._installed.cache_clear()


@pytest.mark.usefixtures("measuring")
def test_measures_are_means_of_metrics_in_trial_order_told_hashed_and_recorded(
    tmp_path: Path, servers: Genes
) -> None:
    """An optimizer that resumes from the record also gets them in order; the order changes bits."""
    complete = loaded(
        "optimizer.kind=measuring",
        "optimizer.measures=['rounds', 'escaped']",
        "problem.trials=3",
        "generations=3",
    )
    assert build(complete).problem.simulator.metrics == ("escaped", "rounds")
    parts = build(complete)
    with created(tmp_path, complete) as record:
        evolution = run.evolve(parts, record, servers, Logger(), threading.Event())  # type: ignore[arg-type]
        for _ in range(2):
            next(evolution)
        evolution.close()
    record, complete = Record.open(record.folder)
    parts = build(complete)
    with record:
        ended = result(run.evolve(parts, record, servers, Logger(), threading.Event()))  # type: ignore[arg-type]
        recorded = list(record.told())
    told = parts.optimizer.told  # type: ignore[attr-defined]
    assert len(told) == len(recorded) == 3
    history = History()
    for workload, measures, generation in zip(
        (*servers.handed[:2], servers.handed[-1]), told, recorded, strict=True
    ):
        metrics = workload.metrics.reshape(-1, 3, 2)
        expected = ((metrics[:, 0] + metrics[:, 1] + metrics[:, 2]) / 3)[:, ::-1]
        assert measures.tobytes() == generation.measures.tobytes() == expected.tobytes()
        history.add(generation.genomes, generation.fitness, expected)
    assert ended.history_hash == history.hex()


@pytest.mark.usefixtures("measuring")
def test_measures_that_are_no_metric_are_refused_with_those_that_are(
    tmp_path: Path,
) -> None:
    complete = loaded(
        "optimizer.kind=measuring", "optimizer.measures=['rounds', 'spread']"
    )
    with pytest.raises(ConfigError) as refusal:
        build(complete)
    words = "optimizer: measures: emergency-exit has no metric 'spread'; it has: escaped, rounds"
    assert str(refusal.value) == words


@pytest.mark.usefixtures("measuring")
@pytest.mark.parametrize("metrics", [[np.nan, 1.0], [1.7e308, 1.7e308], [-np.inf, 1.0]])
def test_a_nonfinite_mean_becomes_the_canonical_nan(metrics: list[float]) -> None:
    problem = build(loaded("problem.trials=2")).problem
    assessment = Assessment(problem, problem.random(2), 0)
    assessment.workload.metrics[:] = 0.5
    assessment.workload.metrics[2:, 1] = metrics
    assert assessment.measures(["rounds"]).tobytes() == np.array([0.5, np.nan]).tobytes()


def test_a_verdict_on_the_probe_is_recorded_at_once_and_known_to_a_resume(
    tmp_path: Path,
) -> None:
    """Until the code that computes is another one."""
    loaded = experiment.load(experiment.find("stadium"), ["generations=2"])
    complete = experiment.complete(loaded, "test")
    verdict = Note(RunEvent.PROBE_ARBITRATED, text=b"12345678".hex())

    class Arbitrated(Genes):
        standing = msgspec.structs.replace(Genes.standing, probe=b"12345678")

        def play(self, _workload: Workload) -> Iterator[Any]:
            yield verdict
            raise Stopped("in the first generation")

    def asked(record: Record, servers: FakeConnection) -> Any:
        with record, pytest.raises(Stopped):
            result(
                run.evolve(build(complete), record, servers, Logger(), threading.Event())  # type: ignore[arg-type]
            )
        return servers.asked["known"].arbitrated, servers.asked["probe"]

    record = Record.create(tmp_path, complete, "0" * 32, ["escaped", "rounds"])
    assert asked(record, Arbitrated()) == (b"", b"")
    again = Record.open(record.folder)[0]
    assert asked(again, Arbitrated()) == (b"12345678", b"12345678")
    other = Record.open(record.folder)[0]
    other.set_meta("arbitrated_by", "1" * 32)
    assert asked(other, Arbitrated()) == (b"", b"12345678")
