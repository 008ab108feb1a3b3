"""The learning curve on held-out seeds: the best of each k-th generation plays some of its own."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.ot.assessment.test_assessed_runs import Noisy, begun, evolved, loaded, resumed
from tests.ot.cluster.fake_connection import result
from zswarm import experiment
from zswarm.errors import ConfigError
from zswarm.kernels.random import derive_seed
from zswarm.ot.analysis import curves, figures
from zswarm.ot.assessment.interval import of_mean
from zswarm.ot.build import build
from zswarm.ot.cluster.events import Counted, Retracted
from zswarm.ot.record.reader import Run
from zswarm.ot.record.rollback import go_back
from zswarm.ot.record.writer import Record
from zswarm.ot.report import report
from zswarm.ot.workload import Workload

TRIALS = 2


def test_the_best_of_each_third_generation_plays_held_out_seeds(tmp_path: Path) -> None:
    _, without = evolved(tmp_path / "without", Noisy())
    servers = Noisy()
    folder, ended = evolved(tmp_path / "with", servers, "assessment.track=3")
    assert ended.history_hash == without.history_hash
    assert ended.assessment_hash == without.assessment_hash
    assert ended.champion == without.champion
    run, work = Run(folder), servers.handed[-1]
    seeds = [derive_seed(loaded().seed, "track", number) for number in range(100)]
    assert [one.generation for one in run.track] == [2, 5]
    assert work.seeds.tolist() == seeds * 2
    for number, one in enumerate(run.track):
        found = max(
            run.candidates(one.generation), key=lambda candidate: candidate["fitness"]
        )
        assert work.genomes[number] == found["genome"]
        played = work.fitness[100 * number : 100 * (number + 1), 0]
        ends = (one.held_out.mean, one.held_out.low, one.held_out.high)
        assert ends == pytest.approx([TRIALS * end for end in of_mean(played)])
        assert (one.held_out.in_search, one.held_out.seeds) == (found["fitness"], 100)
    run.check()
    assert Run(tmp_path / "without" / "stadium").track == []


def test_it_is_drawn_and_reported(tmp_path: Path) -> None:
    folder, _ = evolved(tmp_path, Noisy(), "assessment.track=3")
    run = Run(folder)
    one = curves.series(run)
    lines = figures._of_one(
        one, curves.curves({"a": [one]}, "generation")[0], "generation"
    )
    (drawn,) = (line for line in lines if line.label == "best, held-out")
    assert drawn.x.tolist() == [3.0, 6.0]
    means = [tracked.held_out.mean or 0.0 for tracked in run.track]
    assert drawn.y.tolist() == [mean / TRIALS for mean in means]
    assert max(drawn.y) < one.best.max(), "of a trial, as the search's"
    assert drawn.band is not None
    page = report.of_run(run, 0)
    for tracked in run.track:
        held_out = tracked.held_out
        number, mean = tracked.generation + 1, (held_out.mean or 0.0) / TRIALS
        assert f"generation {number} has {mean:.6g} on 100" in page


def test_repeats_have_the_median_of_their_tracks(tmp_path: Path) -> None:
    """Each run has its own seed, and so its own track; one that has none leaves none."""
    runs = []
    for seed in (1, 2, 3):
        more = ("assessment.track=3", f"seed={seed}")
        runs.append(Run(evolved(tmp_path / f"{seed}", Noisy(), *more)[0]))
    members = [curves.series(run) for run in runs]
    (drawn,) = figures._tracked("a", members, "generation", alone=True)
    assert drawn.x.tolist() == [3.0, 6.0]
    means = [[one.held_out.mean for one in run.track] for run in runs]
    assert drawn.y.tolist() == (np.median(means, axis=0) / TRIALS).tolist()
    (axes,) = figures.of_series({"a": members}).axes
    labels = [text.get_text() for text in axes.get_legend().get_texts()]
    assert "the same, held-out" in labels
    folder, _ = evolved(tmp_path / "none", Noisy(), "seed=4")
    without = [*members, curves.series(Run(folder))]
    assert figures._tracked("a", without, "generation", alone=True) == []


def test_it_needs_no_assessment(tmp_path: Path) -> None:
    more = ("assessment.track=2", "assessment.budget=0")
    folder, ended = evolved(tmp_path, Noisy(), *more)
    assert ended.champion is None
    assert [one.generation for one in Run(folder).track] == [1, 3, 5]
    Run(folder).check()
    go_back(folder, 6)
    assert Run(folder).track == []
    assert resumed(folder, Noisy()).history_hash == ended.history_hash
    assert [one.generation for one in Run(folder).track] == [1, 3, 5]


class Killed(Exception):
    """The program ended here."""


class Dying(Noisy):
    """Servers whose run is killed in the middle of the track, its last workload."""

    def play(self, workload: Workload) -> Iterator[Counted | Retracted]:
        for item in super().play(workload):
            yield item
            if len(workload.seeds) == 200 and np.count_nonzero(workload.counted) > 50:
                raise Killed


def test_a_run_killed_in_it_resumes_there(tmp_path: Path) -> None:
    whole, ended = evolved(tmp_path / "whole", Noisy(), "assessment.track=3")
    complete = loaded("assessment.track=3")
    with (
        Record.create(tmp_path, complete, "0" * 32, ["a", "b"]) as record,
        pytest.raises(Killed),
    ):
        result(begun(record, complete, Dying(batch=7)))
    servers = Noisy()
    again = resumed(record.folder, servers)
    assert again.assessment_hash == ended.assessment_hash
    assert Run(record.folder).track == Run(whole).track != []
    sql = "SELECT sum(count) FROM outcomes"
    counts = [Run(one).rows(sql, tuple[int]) for one in (record.folder, whole)]
    assert counts[0] == counts[1], "no trial is played twice"
    Run(record.folder).check()


@pytest.mark.parametrize(
    ("example", "track", "words"),
    [
        ("stadium", 7, "expected at most the 6 generations, not 7"),
        (
            "minisim-duel",
            2,
            "expected 0, not 2: candidates play each other, so none has a fitness of its own",
        ),
    ],
)
def test_what_cannot_be_tracked_is_refused_in_one_line(
    example: str, track: int, words: str
) -> None:
    changes = ["generations=6", f"assessment.track={track}"]
    file = experiment.load(experiment.find(example), changes)
    with pytest.raises(ConfigError) as refusal:
        build(experiment.complete(file, "test"))
    assert str(refusal.value) == f"assessment: track: {words}"
