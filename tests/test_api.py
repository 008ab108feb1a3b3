"""``import zswarm``, as programs and notebooks use it; with this machine's slots."""

import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

import zswarm
from tests.parameters import some
from zswarm import evaluate, experiment
from zswarm.ot import evaluator
from zswarm.ot.cluster import connection
from zswarm.ot.cluster.shell import Cluster
from zswarm.ot.generation import Assessment
from zswarm.ot.workload import Workload

SMALL = {"generations": 4, "optimizer.population": 20, "problem.settings.steps": 40}
ONE_SLOT = {"cluster.servers": "local", "cluster.local_slots": 1}


@pytest.fixture(scope="module")
def cluster() -> Iterator[zswarm.Connection]:
    with zswarm.connect("local", local_slots=1) as cluster:
        yield cluster


@pytest.fixture(scope="module")
def small() -> zswarm.Experiment:
    return zswarm.load("stadium", SMALL)


def in_this_process(problem: zswarm.Problem, genomes: list[bytes]) -> np.ndarray:
    workload = problem.workload(genomes, 0)
    outcomes = evaluate.evaluate(
        problem.simulator,
        problem.representation,
        workload.genomes,
        workload.participants,
        workload.seeds,
    )
    return outcomes.fitness.reshape(len(genomes), -1)


def wait_until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 30.0
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.005)


def same_bits(left: np.ndarray, right: np.ndarray) -> bool:
    return left.dtype == right.dtype == np.float64 and left.tobytes() == right.tobytes()


# ---- the names


def test_importing_zswarm_loads_nothing_until_a_name_is_used() -> None:
    code = "import sys, zswarm; loaded = {'numpy', 'msgspec', 'zswarm.api'} & set(sys.modules); "
    code += "zswarm.load; print(loaded)"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False
    )
    assert (done.stdout, done.stderr) == ("set()\n", "")


@pytest.mark.parametrize("name", zswarm.__all__)
def test_every_public_name_exists_and_is_documented(name: str) -> None:
    assert getattr(zswarm, name).__doc__
    assert name in dir(zswarm)


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="has no attribute 'evolve'"):
        _ = zswarm.evolve  # type: ignore[attr-defined]


# ---- experiments


def test_settings_change_an_experiment_as_the_command_line_does() -> None:
    """Examples, mappings, experiments and numpy's numbers work; the source is unchanged."""
    given: dict[str, Any] = {
        "seed": np.int64(7),
        "optimizer.population": 60,
        "problem.settings.agents": 12,
    }
    path = experiment.find("stadium")
    expected = experiment.load(
        path, ["seed=7", "optimizer.population=60", "problem.settings.agents=12"]
    )
    unchanged = zswarm.load("stadium")
    assert zswarm.load("stadium", given) == expected
    assert zswarm.load(path, given) == expected
    assert zswarm.load(unchanged, given) == expected
    mapping = experiment.to_mapping(unchanged)
    assert zswarm.load(mapping, given) == expected
    assert zswarm.load(unchanged) == zswarm.load(mapping) == experiment.load(path)


@pytest.mark.parametrize(
    ("source", "settings", "line"),
    [
        ("stadum", {}, "did you mean 'stadium'"),
        ("stadium", {"optimizer.populaton": 3}, "did you mean 'population'"),
        ("stadium", {"optimiser.population": 3}, "unknown key 'optimiser'"),
        ("stadium", {"seed.x": 3}, "seed is not a table"),
        ("stadium", {"seed": "one"}, "seed: expected int, got str"),
        ({}, {}, "experiment: key name is missing"),
        ({"name": "x"}, {}, "experiment: key seed is missing"),
    ],
)
def test_an_invalid_experiment_is_refused_in_one_line(
    source: Any, settings: dict[str, Any], line: str
) -> None:
    with pytest.raises(zswarm.ConfigError) as caught:
        zswarm.load(source, settings)
    assert line in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("settings", "line"),
    [
        ({"seed": "one"}, 'seed = "one": seed: expected int, got str'),
        ({"optimizer.pop": 3}, "optimizer.pop = 3: optimizer: unknown key 'pop'"),
        (
            {"generations": 9, "optimizer.population": 1},
            "optimizer.population = 1: optimizer: population: expected int >= 2",
        ),
        ({3: 1}, "3 = 1: unknown key '3'"),
    ],
)
def test_an_invalid_setting_is_named_and_not_the_file(
    settings: dict[str, Any], line: str
) -> None:
    with pytest.raises(zswarm.ConfigError) as caught:
        zswarm.load("stadium", settings)
    assert str(caught.value).startswith(line)


def test_an_experiment_of_parts_that_are_not_installed_can_be_loaded() -> None:
    """It can be examined; it is refused when it is used."""
    loaded = zswarm.load("stadium", {"problem.simulator": "elsewhere"})
    with pytest.raises(zswarm.UnknownPlugin, match="elsewhere"):
        zswarm.problem(loaded)


@pytest.mark.parametrize(
    ("call", "line"),
    [
        (
            lambda: zswarm.load(None),
            "experiment: expected a file, the name of an example",
        ),
        (lambda: zswarm.load(3), "dict or an experiment, not 3"),
        (
            lambda: zswarm.load("stadium", ["a"]),
            r"settings: expected a dict, such as .*, not \['a'\]",
        ),
        (lambda: zswarm.problem("stadium", settings=["a"]), "settings: expected a dict"),
        (lambda: zswarm.study("stadium", grid=["a"]), "grid: expected a dict of lists"),
        (
            lambda: zswarm.study("stadium", grid={"optimizer.population": 4}),
            "optimizer.population: expected a list of values",
        ),
        (
            lambda: zswarm.study("stadium", grid={"optimizer.kind": "nnga"}),
            r"such as \['nnga'\], not 'nnga'",
        ),
        (lambda: list(zswarm.start("stadium")), "with zswarm.start"),
        (
            lambda: zswarm.run("stadium", servers=3),  # type: ignore[call-arg]
            r"'servers' is no argument of zswarm.run, .*, \{'cluster.servers': 3\}\)$",
        ),
        (
            lambda: zswarm.start("stadium", generations=5),  # type: ignore[call-arg]
            r"\{'generations': 5\}",
        ),
        (
            lambda: zswarm.run("stadium", settings={"seed": 2}),  # type: ignore[call-arg]
            r"\{'seed': 2\}",
        ),
        (
            lambda: zswarm.study("stadium", repeats=4),  # type: ignore[call-arg]
            r"takes experiment, repeat, grid, .*\{'optimizer.population': 100\}",
        ),
    ],
)
def test_arguments_of_a_wrong_type_are_refused_with_what_was_expected(
    call: Any, line: str
) -> None:
    with pytest.raises(TypeError, match=line):
        call()


def test_finishing_a_run_outside_a_with_block_explains_the_error() -> None:
    with pytest.raises(AttributeError, match=r"with zswarm\.start"):
        zswarm.start("stadium").finish()  # type: ignore[attr-defined]


def test_a_run_that_cannot_start_fails_at_the_call() -> None:
    with pytest.raises(zswarm.ConfigError, match="nope: no run"):
        zswarm.resume("nope")
    with pytest.raises(zswarm.ConfigError, match="populaton"):
        zswarm.start(
            {
                **experiment.to_mapping(zswarm.load("stadium")),
                "optimizer": {"kind": "nnga", "populaton": 3},
            }
        )


def test_a_problem_is_made_of_parts() -> None:
    """The same as that of an experiment with these parts; what is left out has its default."""
    parts = zswarm.problem(
        simulator="emergency-exit",
        settings={"steps": 40},
        representation={"kind": "fully-meshed", "hidden": 3},
        trials=5,
        seed=4,
    )
    changes = {
        "problem.trials": 5,
        "problem.settings": {"steps": 40},
        "representation": {"kind": "fully-meshed", "hidden": 3},
    }
    whole = zswarm.problem(zswarm.load("emergency-exit", {**changes, "seed": 4}))
    assert parts == whole
    assert parts.genes == len(parts.random(1)[0]) // 4
    game = zswarm.problem(
        simulator="minisim",
        settings={"teams": 2, "defenders": 0},
        ranking={"kind": "swiss", "rounds": 3},
    )
    assert (
        type(game.ranking).__name__,
        msgspec.to_builtins(game.ranking.settings)["rounds"],
    ) == (
        "Swiss",
        3,
    )
    with pytest.raises(zswarm.ConfigError, match="expected an experiment or a simulator"):
        zswarm.problem()
    with pytest.raises(zswarm.ConfigError, match="agent"):
        zswarm.problem("stadium", settings={"agent": 3})


def test_problems_and_connections_have_a_readable_repr() -> None:
    few = zswarm.problem("emergency-exit", trials=2)
    assert (
        repr(few)
        == f"<zswarm.Problem: emergency-exit, 2 trials; fully-meshed, {few.genes} genes>"
    )
    with zswarm.connect(2, realm="lab", multicast=False) as cluster:
        assert repr(cluster) == "<zswarm.Connection: 2 servers in realm lab>"
    assert repr(cluster) == "<zswarm.Connection: closed>"


def test_vectors_and_genomes_are_the_same_candidates() -> None:
    problem = zswarm.problem("stadium")
    genomes = problem.random(3, seed=5)
    vectors = problem.vectors(genomes)
    assert vectors.shape == (3, problem.genes)
    assert (
        problem.genomes(vectors)
        == problem.genomes(list(vectors.astype(float)))
        == problem.genomes(genomes)
        == genomes
    )
    assert problem.random(3, seed=6) != genomes
    assert problem.genomes([]) == []


@pytest.mark.parametrize(
    ("make", "line"),
    [
        (
            lambda genes: np.zeros((2, genes + 1)),
            r"expected shape \(n, 60\), not \(2, 61\)",
        ),
        (lambda genes: np.zeros(genes), r"expected shape \(n, 60\), not \(60,\)"),
        (lambda genes: np.full((2, genes), np.nan), "not finite"),
        (lambda genes: np.full((2, genes), 1e300), "not finite"),
        (lambda _: [b"short"], "5 bytes"),
        (
            lambda genes: np.zeros((2, genes), complex),
            "expected real numbers, not an array of complex128",
        ),
        (lambda genes: [["a"] * genes], "expected real numbers"),
        (lambda _: [[1.0], [1.0, 2.0]], "vectors of equal length"),
        (lambda genes: [b"\0" * 4 * genes, [0.0] * genes], "not both"),
    ],
)
def test_candidates_that_do_not_fit_are_refused_before_they_travel(
    make: Any, line: str
) -> None:
    problem = zswarm.problem("stadium")
    assert problem.genes == 60
    with pytest.raises(ValueError, match=line):
        problem.genomes(make(problem.genes))
    for what in (None, 3, b"genome", "genome", {"a": 1}):
        with pytest.raises(
            TypeError, match="candidates: expected a list of genomes or an array"
        ):
            problem.genomes(what)  # type: ignore[arg-type]


def test_the_count_of_random_genomes_must_be_a_whole_number() -> None:
    problem = zswarm.problem("stadium")
    with pytest.raises(ValueError, match="count: expected a whole number from 0 to"):
        problem.random(-1)
    with pytest.raises(TypeError, match=r"count: expected a whole number, not 2\.5"):
        problem.random(2.5)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="seed: expected a whole number from 0 to"):
        problem.random(1, seed=-1)


# ---- evaluating


def test_servers_compute_the_bits_of_this_process(cluster: zswarm.Connection) -> None:
    """Fitness is the sum over the trials in trial order, for genomes and for vectors."""
    problem = zswarm.problem("emergency-exit", settings={"steps": 40}, trials=3)
    genomes = problem.random(20)
    expected = np.cumsum(in_this_process(problem, genomes), axis=1)[:, -1]
    assert same_bits(cluster.evaluate(problem, genomes), expected)
    assert same_bits(cluster.evaluate(problem, problem.vectors(genomes)), expected)
    assert cluster.evaluate(problem, []).shape == (0,)


def test_candidates_of_a_game_play_each_other(cluster: zswarm.Connection) -> None:
    """The results are their scores, as in a run; no candidate has trials of its own."""
    problem = zswarm.problem(zswarm.load("minisim-duel", {"problem.settings.steps": 40}))
    genomes = problem.random(5)
    assessment = Assessment(problem, genomes, 0)
    while True:
        work = assessment.workload
        played = evaluate.evaluate(
            problem.simulator,
            problem.representation,
            genomes,
            work.participants,
            work.seeds,
        )
        work.fitness[:] = played.fitness
        if not assessment.advance():
            break
    scores = cluster.evaluate(problem, genomes)
    assert same_bits(scores, assessment.fitness())
    assert scores.sum() == 3 * (2 * 2 + 2), "two games and a bye in each of three rounds"
    with pytest.raises(
        ValueError,
        match="minisim is a game of 2: no candidate has trials of its own; evaluate has candidates",
    ):
        cluster.outcomes(problem, genomes)
    with pytest.raises(
        zswarm.ConfigError, match="a game of 2 needs as many candidates; there are 1"
    ):
        cluster.evaluate(problem, genomes[:1])


def test_outcomes_are_returned_by_trial_for_any_seeds(cluster: zswarm.Connection) -> None:
    problem = zswarm.problem("emergency-exit", settings={"steps": 40}, trials=3)
    genomes = problem.random(5)
    own = cluster.outcomes(problem, genomes)
    assert same_bits(own.fitness, in_this_process(problem, genomes))
    assert {name: values.shape for name, values in own.metrics.items()} == {
        "escaped": (5, 3),
        "rounds": (5, 3),
    }
    assert repr(own) == "CandidateOutcomes(fitness: 5 x 3, metrics: escaped, rounds)"
    unseen = cluster.outcomes(problem, genomes, seeds=[2**63 + 1, 8])
    assert unseen.fitness.shape == (5, 2)
    assert not np.isin(unseen.fitness, own.fitness).all()
    assert cluster.outcomes(problem, []).fitness.shape == (0, 3)
    for seeds in ([], [-1], [1, 2**64]):
        with pytest.raises(
            ValueError,
            match=r"seeds: expected a list of whole numbers, one at least, .* not ",
        ):
            cluster.outcomes(problem, genomes, seeds=seeds)
    wrong: Any
    for wrong in (5, [1.5], ["1"], np.array([1.0])):
        with pytest.raises(TypeError, match="seeds: expected a list of whole numbers"):
            cluster.outcomes(problem, genomes, seeds=wrong)
    assert same_bits(
        cluster.outcomes(
            problem, genomes, seeds=np.array([2**63 + 1, 8], np.uint64)
        ).fitness,
        unseen.fitness,
    )
    for first, second in (("stadium", genomes), (genomes, problem)):
        with pytest.raises(
            TypeError,
            match=r"problem: expected what zswarm\.problem gives, before the candidates",
        ):
            cluster.evaluate(first, second)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="generation: expected a whole number from 0"):
        cluster.evaluate(problem, genomes, generation=-1)


def test_fresh_trials_are_those_of_the_generation(cluster: zswarm.Connection) -> None:
    problem = zswarm.problem(
        "emergency-exit", settings={"steps": 40}, trials=3, seeds="fresh"
    )
    genomes = problem.random(4)
    first, second = (
        cluster.evaluate(problem, genomes, generation=generation) for generation in (0, 1)
    )
    assert same_bits(first, cluster.evaluate(problem, genomes))
    assert not same_bits(first, second)


def test_parallel_threads_get_their_own_results(
    cluster: zswarm.Connection,
) -> None:
    """The threads evaluate two problems with different numbers of candidates."""
    problems = [
        zswarm.problem("stadium", settings={"steps": steps}) for steps in (20, 30)
    ]
    calls = [
        (problems[number % 2], problems[0].random(1 + number, seed=number))
        for number in range(6)
    ]
    with ThreadPoolExecutor(6) as threads:
        found = list(threads.map(lambda call: cluster.evaluate(*call), calls))
    for (problem, genomes), fitness in zip(calls, found, strict=True):
        assert same_bits(fitness, in_this_process(problem, genomes)[:, 0])


def test_waiting_calls_are_evaluated_together(
    cluster: zswarm.Connection, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Threads with one candidate each keep all slots busy."""
    problem = zswarm.problem("stadium", settings={"steps": 20})
    together: list[int] = []
    play = evaluator.CandidateEvaluator._play

    def counting(self: evaluator.CandidateEvaluator, of: bytes, calls: list[Any]) -> None:
        together.append(len(calls))
        play(self, of, calls)

    monkeypatch.setattr(evaluator.CandidateEvaluator, "_play", counting)
    kept = cluster._evaluator
    assert kept is not None
    with ThreadPoolExecutor(5) as threads:
        with kept._turn:
            waiting = [
                threads.submit(cluster.evaluate, problem, problem.random(1, seed))
                for seed in range(5)
            ]
            wait_until(lambda: len(kept._calls) == 5)
        found = [float(call.result()[0]) for call in waiting]
    assert together == [5]
    assert found == [
        float(in_this_process(problem, problem.random(1, seed))[0, 0])
        for seed in range(5)
    ]


def test_results_of_an_interrupted_call_do_not_reach_the_next(
    cluster: zswarm.Connection, monkeypatch: pytest.MonkeyPatch
) -> None:
    """This holds even if the call was complete in the meantime."""
    problem = zswarm.problem("stadium", settings={"steps": 20})
    play = Cluster.evaluate

    def interrupted(self: Cluster, workload: Workload) -> Iterator[Any]:
        yield next(play(self, workload))
        wait_until(lambda: bool(workload.counted.all()))
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(Cluster, "evaluate", interrupted)
        with pytest.raises(KeyboardInterrupt):
            cluster.evaluate(problem, problem.random(7))
    genomes = problem.random(7, seed=2)
    assert same_bits(
        cluster.evaluate(problem, genomes), in_this_process(problem, genomes)[:, 0]
    )


def test_idle_slots_are_released(monkeypatch: pytest.MonkeyPatch) -> None:
    """An open notebook does not keep a lab's servers; the next call reserves them again."""
    monkeypatch.setattr(evaluator, "IDLE_S", 0.05)
    problem = zswarm.problem("stadium", settings={"steps": 20})
    with zswarm.connect("local", local_slots=1) as cluster:
        before = cluster.evaluate(problem, problem.random(2))
        kept = cluster._evaluator
        assert kept is not None
        released = threading.Event()
        drop = kept._drop
        monkeypatch.setattr(kept, "_drop", lambda: (drop(), released.set()))
        assert released.wait(30.0)
        assert kept._cluster is None
        assert same_bits(cluster.evaluate(problem, problem.random(2)), before)
    with pytest.raises(RuntimeError, match="connect again"):
        cluster.evaluate(problem, problem.random(2))
    cluster.close()


def test_waiting_for_servers_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connection, "WAIT_FOR_SERVERS_S", 0.1)
    problem = zswarm.problem("stadium")
    with zswarm.connect(2, multicast=False) as cluster:
        for _ in range(2):
            with pytest.raises(
                zswarm.NoServers, match=r"0 of 2 matching servers were found in 0\.1 s"
            ):
                cluster.evaluate(problem, problem.random(2))


@pytest.mark.parametrize("trials", some([5_000, 50_000], 5_000))
def test_closing_ends_evaluations_of_other_threads(trials: int) -> None:
    problem = zswarm.problem("emergency-exit", trials=trials)
    cluster = zswarm.connect("local", local_slots=1)
    with ThreadPoolExecutor(1) as threads:
        call = threads.submit(cluster.evaluate, problem, problem.random(500))
        wait_until(
            lambda: (
                cluster._evaluator is not None and cluster._evaluator._cluster is not None
            )
        )
        cluster.close()
        with pytest.raises(zswarm.Stopped):
            call.result()


# ---- runs


def test_a_resumed_run_has_the_history_of_an_uninterrupted_one(
    cluster: zswarm.Connection, small: zswarm.Experiment, tmp_path: Path
) -> None:
    """Several runs share a connection one after another, with evaluations in between."""
    whole = zswarm.run(small, connection=cluster, out=tmp_path)
    assert (whole.finished, whole.generations(), whole.name) == (True, 4, "stadium")
    assert whole.experiment.cluster == cluster.options
    problem = zswarm.problem(small)
    champion = whole.champion()
    assert champion is not None
    assert cluster.evaluate(problem, [champion.genome])[0] == whole.best()
    with zswarm.start(small, connection=cluster, out=tmp_path) as evolution:
        for generation in evolution:
            with pytest.raises(RuntimeError, match="leave its block first"):
                cluster.evaluate(problem, problem.random(1))
            if generation.generation == 1:
                break
    left = evolution.run
    assert (left.finished, left.generations(), evolution.result) == (False, 2, None)
    cluster.evaluate(problem, problem.random(1))
    with zswarm.resume(left, connection=cluster) as evolution:
        assert [generation.generation for generation in evolution] == [2, 3]
    assert evolution.result is not None
    assert (
        evolution.result.history_hash
        == zswarm.read(left.folder).history_hash
        == whole.history_hash
    )
    assert zswarm.load(left.folder, {"name": "other"}).problem == whole.experiment.problem


def test_two_runs_of_one_thread_do_not_deadlock(
    cluster: zswarm.Connection, small: zswarm.Experiment, tmp_path: Path
) -> None:
    with (
        zswarm.start(small, connection=cluster, out=tmp_path) as one,
        zswarm.start(small, connection=cluster, out=tmp_path) as two,
    ):
        next(iter(one))
        with pytest.raises(RuntimeError, match="leave its block first"):
            next(iter(two))


def test_an_error_in_the_loop_says_how_to_resume(
    cluster: zswarm.Connection, small: zswarm.Experiment, tmp_path: Path
) -> None:
    def one_generation() -> None:
        with zswarm.start(small, connection=cluster, out=tmp_path) as evolution:
            next(iter(evolution))
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError) as caught:
        one_generation()
    assert caught.value.__notes__ == [
        f"nothing is lost; to resume: zswarm.resume({str(tmp_path / 'stadium')!r})"
    ]


def test_a_run_is_stopped_from_another_thread(
    cluster: zswarm.Connection, tmp_path: Path
) -> None:
    """It stops in the middle of a generation."""
    endless = zswarm.load("stadium", {"generations": 1_000_000})
    with zswarm.start(endless, connection=cluster, out=tmp_path) as evolution:
        generations = iter(evolution)
        next(generations)
        timer = threading.Timer(0.1, evolution.stop)
        timer.start()
        with pytest.raises(zswarm.Stopped):
            for _ in generations:
                pass
        timer.join()
    assert evolution.run.generations() > 0


def test_closing_ends_the_runs_of_other_threads(tmp_path: Path) -> None:
    """They would wait for ever for slots that are gone."""
    endless = zswarm.load("stadium", {**SMALL, "generations": 1_000_000})
    cluster = zswarm.connect("local", local_slots=1)
    with ThreadPoolExecutor(1) as threads:
        run = threads.submit(zswarm.run, endless, connection=cluster, out=tmp_path)
        wait_until(lambda: cluster.slots > 0 or run.done())
        cluster.close()
        with pytest.raises(zswarm.Stopped, match="closed") as caught:
            run.result(60.0)
    assert "to resume: zswarm.resume" in caught.value.__notes__[0]


def test_a_stopped_run_is_not_finished(
    cluster: zswarm.Connection, small: zswarm.Experiment, tmp_path: Path
) -> None:
    with zswarm.start(small, connection=cluster, out=tmp_path) as evolution:
        evolution.stop()
        with pytest.raises(zswarm.Stopped):
            evolution.finish()
        with pytest.raises(RuntimeError, match="this run was stopped: resume it"):
            evolution.finish()


def test_a_run_in_a_thread_does_not_touch_signals(
    tmp_path: Path, small: zswarm.Experiment
) -> None:
    """The run has slots of its own."""
    with ThreadPoolExecutor(1) as threads:
        run = threads.submit(
            zswarm.run, zswarm.load(small, ONE_SLOT), out=tmp_path
        ).result()
    assert run.finished


def test_nothing_is_printed_unless_requested(
    cluster: zswarm.Connection,
    small: zswarm.Experiment,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
) -> None:
    zswarm.run(small, connection=cluster, out=tmp_path, loggers=zswarm.Logger())
    assert capfd.readouterr() == ("", "")
    zswarm.run(small, connection=cluster, out=tmp_path, progress=True)
    shown = capfd.readouterr()
    assert "best fitness" in shown.out
    assert "generation 4/4" in shown.err


def test_histories_are_data_frames(
    cluster: zswarm.Connection, small: zswarm.Experiment, tmp_path: Path
) -> None:
    run = zswarm.run(small, connection=cluster, out=tmp_path)
    history = run.history()
    for frame in (run.to_pandas(), run.to_polars()):
        columns = list(frame.columns)
        assert columns[:6] == [
            "generation",
            "finished_at",
            "seconds",
            "best",
            "mean",
            "evaluations",
        ]
        assert "diversity_mean" in columns
        assert "statistics" not in columns
        assert list(frame["best"]) == [row["best"] for row in history]
    shown = run._repr_html_()
    assert f"{run.best():.6g}" in shown
    assert "4 of 4, finished" in shown


def test_an_invalid_logger_is_refused(small: zswarm.Experiment, tmp_path: Path) -> None:
    wrong: Any
    for wrong in ([print], print, [zswarm.Logger], 3):
        with pytest.raises(TypeError, match="loggers: expected instances of"):
            zswarm.run(zswarm.load(small, ONE_SLOT), out=tmp_path, loggers=wrong)
    assert not list(tmp_path.iterdir())


# ---- studies


def test_runs_of_a_study_share_a_connection_and_can_be_resumed(
    cluster: zswarm.Connection, small: zswarm.Experiment, tmp_path: Path
) -> None:
    runs = zswarm.study(
        small,
        repeat=2,
        grid={"optimizer.population": np.array([10, 12])},
        connection=cluster,
        out=tmp_path,
    )
    shown = [
        (
            run.experiment.optimizer.settings["population"],
            run.experiment.seed,
            run.finished,
        )
        for run in runs
    ]
    assert shown == [(10, 1, True), (12, 1, True), (10, 2, True), (12, 2, True)]
    assert all(run.experiment.cluster == cluster.options for run in runs)
    again = zswarm.study(runs[0].folder.parent, connection=cluster)
    assert [run.history_hash for run in again] == [run.history_hash for run in runs]
    whole = str(runs[0].folder.parent)
    with pytest.raises(
        zswarm.ConfigError, match=r"read one of them, .* all of them with zswarm\.tidy"
    ) as refused:
        zswarm.read(whole)
    assert f"zswarm.tidy({whole!r})" in str(refused.value)
    assert len(zswarm.tidy(whole)) == 4
    with pytest.raises(zswarm.ConfigError, match="a study is resumed as it is"):
        zswarm.study(runs[0].folder.parent, repeat=3, connection=cluster)
    with pytest.raises(zswarm.ConfigError, match="populaton"):
        zswarm.study(
            small, grid={"optimizer.populaton": [1, 2]}, connection=cluster, out=tmp_path
        )
    assert len(zswarm.plot(*runs).axes[0].lines) >= 2


# ---- champions


def test_a_driver_repeats_the_decisions_of_evolution(
    cluster: zswarm.Connection, small: zswarm.Experiment, tmp_path: Path
) -> None:
    """A trial played turn by turn with one driver per agent has the champion's fitness."""
    run = zswarm.run(small, connection=cluster, out=tmp_path)
    champion = run.champion()
    assert champion is not None
    problem = zswarm.problem(run.experiment)
    simulator = problem.simulator
    drivers = [champion.driver() for _ in simulator.owners]
    for _ in range(2):
        for driver in drivers:
            driver.reset()
        turn = simulator.reset(int(problem.trial_seeds(0)[0]))
        while turn is not None:
            decided = [
                drivers[agent].act(observation)
                for agent, observation in zip(turn.agents, turn.observations, strict=True)
            ]
            turn = simulator.step(np.stack(decided))
        assert simulator.outcome().fitness[0] == run.best()
    with pytest.raises(
        ValueError, match=r"observation: expected shape \(\d+,\), not \(1,\)"
    ):
        drivers[0].act([0.0])
