"""Settings that differ by trial: draws, trials with the drawn settings, and refusals."""

import itertools
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import msgspec
import numpy as np
import pytest

from tests.config.test_ranges import Settings
from zswarm.config import ranges
from zswarm.errors import ConfigError
from zswarm.evaluate import build, evaluate, turns
from zswarm.kernels.random import Stream, derive_seed
from zswarm.nets.fully_meshed import FullyMeshed, FullyMeshedSettings
from zswarm.ot.replay import trace
from zswarm.plugins import registry as plugins
from zswarm.probe import probe
from zswarm.sims.emergency_exit import EmergencyExit
from zswarm.sims.randomized import KEPT, Varied, drawn
from zswarm.sims.simulator import HostingSimulator, KernelBatch, Outcome, Simulator, Turn

AGENTS = {"agents": {"from": 5, "to": 15}}


class Herd(Simulator):
    """Robots that act once; the fitness is their settings in a number. It does not like seven."""

    settings_type = Settings
    inputs = outputs = 1
    settings: Settings

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings)
        if settings.robots == 7:
            raise ConfigError("seven robots do not fit")
        self.owners = (0,) * settings.robots
        if settings.gait == "run":
            self.metrics = ("falls",)

    def reset(self, seed: int) -> Turn:
        return Turn(
            range(self.settings.robots),
            np.full((self.settings.robots, 1), seed % 5, np.float32),
        )

    def step(self, actions: np.ndarray) -> None:
        assert actions.shape == (self.settings.robots, 1)

    def outcome(self) -> Outcome:
        return Outcome([self.settings.robots * 1000 + self.settings.mass], [])


NETWORK = FullyMeshed(FullyMeshedSettings(hidden=1), 1, 1)


def herd(**settings: Any) -> Varied:
    whole = ranges.complete(settings, Settings, "it")
    return Varied(whole, lambda plain: Herd(msgspec.convert(plain, Settings)))


def played(simulator: str, settings: dict[str, Any], seeds: list[int]) -> list[bytes]:
    """Return the outcomes of random genomes, a trial of each on each seed."""
    built, network = build(simulator, settings, "fully-meshed", {})
    genomes = network.random(2, Stream(3))
    participants = np.repeat(np.arange(2), len(seeds))[:, None]
    outcomes = evaluate(
        built, network, genomes, participants, np.array(seeds * 2, np.uint64)
    )
    assert outcomes.error == ""
    return [row.tobytes() for row in np.hstack([outcomes.fitness, outcomes.metrics])]


# ---- draws


def test_a_draw_depends_only_on_the_seed_and_its_own_range() -> None:
    """Draws follow the formulas of the document; other ranges and their order do not matter."""
    settings = {
        "robots": {"from": 1, "to": 9},
        "mass": {"from": 1.0, "to": 2.0},
        "gait": {"choice": ["walk", "run"]},
        "wind": 3,
    }
    assert drawn(settings, 1) == DRAWN
    word = derive_seed(1, "settings robots")
    assert 1 + (9 * word >> 64) == DRAWN["robots"]
    reordered = dict(reversed(settings.items()))
    for seed in range(20):
        assert drawn(reordered, seed) == drawn(settings, seed)
        assert drawn({"robots": settings["robots"]}, seed) == {
            "robots": drawn(settings, seed)["robots"]
        }


DRAWN = {"robots": 3, "mass": 1.1319406877773202, "gait": "run", "wind": 3}


def test_draws_are_uniform_and_include_integer_ends() -> None:
    settings = {
        "whole": {"from": -2, "to": 2},
        "float": {"from": -1.0, "to": 3.0},
        "choice": {"choice": ["a", "b", "b"]},
        "one": {"from": 4, "to": 4},
        "point": {"from": 0.1, "to": 0.1},
        "table": {"deep": {"from": 0, "to": 1}},
    }
    all_of = [drawn(settings, seed) for seed in range(4000)]
    counts = [sum(one["whole"] == value for one in all_of) for value in range(-2, 3)]
    assert sum(counts) == 4000
    assert 650 < min(counts) <= max(counts) < 950
    floats = np.array([one["float"] for one in all_of])
    assert -1.0 <= floats.min() < -0.98
    assert 2.98 < floats.max() <= 3.0
    assert abs(floats.mean() - 1) < 0.08
    assert 0.63 < np.mean([one["choice"] == "b" for one in all_of]) < 0.7
    assert {one["one"] for one in all_of} == {4}
    assert {one["point"] for one in all_of} == {0.1}
    assert {one["table"]["deep"] for one in all_of} == {0, 1}
    assert abs(np.corrcoef(floats, [one["whole"] for one in all_of])[0, 1]) < 0.06


# ---- trials


@pytest.mark.parametrize(
    ("simulator", "settings"),
    [
        ("emergency-exit", {**AGENTS, "steps": 20, "exits": {"choice": [1, 5]}}),
        (
            "arena",
            {"robots": {"from": 2, "to": 20}, "side": {"from": 2, "to": 6}, "steps": 20},
        ),
        (
            "minisim",
            {
                "robots": {"from": 1, "to": 9},
                "defenders": {"choice": [0, 3]},
                "steps": 20,
            },
        ),
    ],
)
def test_a_trial_is_played_with_the_drawn_settings(
    simulator: str, settings: dict[str, Any]
) -> None:
    """Bit for bit, in a batch, in another order and by turns; with more seeds than are cached."""
    seeds = list(range(1000, 1000 + KEPT + 3))
    together = played(simulator, settings, seeds)
    expected = [
        played(
            simulator,
            drawn(ranges.complete(settings, settings_type(simulator), "it"), seed),
            [seed],
        )
        for seed in seeds
    ]
    assert together == [
        row for of_genome in zip(*expected, strict=True) for row in of_genome
    ]
    assert (
        played(simulator, settings, seeds[::-1])
        == together[: len(seeds)][::-1] + together[len(seeds) :][::-1]
    )
    assert len(set(together)) > len(seeds) / 2


def settings_type(simulator: str) -> type[msgspec.Struct]:
    kind: type[msgspec.Struct] = plugins.load("simulator", simulator).settings_type
    return kind


def test_a_range_of_one_value_equals_the_value() -> None:
    seeds = [3, 4]
    assert played("emergency-exit", {"agents": {"from": 9, "to": 9}}, seeds) == played(
        "emergency-exit", {"agents": 9}, seeds
    )


def test_without_ranges_nothing_is_drawn() -> None:
    assert (
        type(build("emergency-exit", {"agents": 5}, "fully-meshed", {})[0])
        is EmergencyExit
    )


class Watched(Herd):
    """Record the trial that progress names when it is played."""

    progress = np.zeros(2, np.int64)
    noted: ClassVar[list[tuple[int, int]]] = []
    stop_after = 10**9

    def reset(self, seed: int) -> Turn:
        self.noted.append((seed, int(self.progress[0])))
        self.progress[1] = len(self.noted) == self.stop_after
        return super().reset(seed)


@pytest.mark.parametrize("stop_after", [3, 10**9])
def test_progress_names_the_current_trial_and_stops_before_the_next(
    stop_after: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Trials are sorted by settings, so each simulator is set up once for a batch."""
    monkeypatch.setattr(Watched, "noted", [])
    monkeypatch.setattr(Watched, "stop_after", stop_after)
    Watched.progress[:] = 0
    built: list[int] = []

    def build_one(plain: dict[str, Any]) -> Simulator:
        built.append(plain["robots"])
        return Watched(msgspec.convert(plain, Settings))

    varied = Varied(
        ranges.complete({"robots": {"choice": list(range(1, 6)) * 10}}, Settings, "it"),
        build_one,
    )
    monkeypatch.setattr("zswarm.sims.randomized.KEPT", 2)
    built.clear()
    seeds = np.array([*range(20), *range(20)], np.uint64)
    outcomes = evaluate(
        varied,
        NETWORK,
        NETWORK.random(1, Stream(1)),
        np.zeros((40, 1), int),
        seeds,
        Watched.progress,
    )
    assert [seed for seed, _ in Watched.noted] == [
        int(seeds[trial]) for _, trial in Watched.noted
    ]
    played = [trial for _, trial in Watched.noted]
    assert len(set(played)) == len(played) == min(stop_after, 40)
    assert np.isfinite(outcomes.fitness[played]).all()
    assert np.isfinite(outcomes.fitness).sum() == len(played)
    assert len(built) == len(set(built))


def test_a_kernel_plays_several_trials_per_call_and_stops_between_calls(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """More of them if they are short; progress names the first of the call."""
    progress, calls = np.zeros(2, np.int64), []
    play_lanes = EmergencyExit.play_lanes

    def watched(
        self: EmergencyExit, step_lanes: Any, step: Any, batch: KernelBatch
    ) -> None:
        calls.append((int(progress[0]), len(batch.seeds)))
        progress[1] = len(calls) == 3
        play_lanes(self, step_lanes, step, batch)

    built, network = build("emergency-exit", AGENTS, "fully-meshed", {})
    assert isinstance(built, Varied)
    monkeypatch.setattr(EmergencyExit, "play_lanes", watched)
    monkeypatch.setattr(
        built, "took", lambda _seconds: setattr(built, "together", 2 * built.together)
    )
    other = next(seed for seed in range(8, 99) if drawn(AGENTS, seed) != drawn(AGENTS, 7))
    seeds = np.array([7, other] * 10, np.uint64)
    outcomes = evaluate(
        built,
        network,
        network.random(1, Stream(1)),
        np.zeros((20, 1), int),
        seeds,
        progress,
    )
    assert calls == [(0, 1), (2, 2), (6, 4)]
    assert np.isfinite(outcomes.fitness[:, 0]).tolist() == [
        trial % 2 == 0 and trial < 14 for trial in range(20)
    ]


def test_trials_per_call_adapt_to_their_time() -> None:
    varied = herd(robots={"from": 1, "to": 2})
    for seconds, together in [
        *((0.001, 2**more) for more in range(1, 9)),
        (0.001, 256),
        (0.03, 128),
        (0.03, 64),
    ]:
        varied.took(seconds)
        assert varied.together == together
    for _ in range(9):
        varied.took(1.0)
    assert varied.together == 1


def test_the_number_of_agents_may_differ_by_trial() -> None:
    """Each robot has its own state in turns, and a picture shows all robots."""
    varied, genomes = herd(robots={"from": 1, "to": 5}), NETWORK.random(1, Stream(1))
    assert varied.agents == (1, 5)
    seeds = np.arange(30, dtype=np.uint64)
    outcomes = evaluate(varied, NETWORK, genomes, np.zeros((30, 1), int), seeds)
    numbers = [
        drawn({"robots": {"from": 1, "to": 5}}, seed)["robots"] for seed in range(30)
    ]
    assert outcomes.fitness[:, 0].tolist() == [1000 * number + 1 for number in numbers]
    assert set(numbers) == {1, 2, 3, 4, 5}
    parameters = NETWORK.parameters(genomes)
    assert [
        len(next(turns(varied, NETWORK, parameters, seed)).agents) for seed in range(30)
    ] == numbers
    arena, network = build(
        "arena", {"robots": {"from": 2, "to": 9}, "steps": 2}, "fully-meshed", {}
    )
    pictures = trace.record(arena, network, network.random(1, Stream(1)), 5).frames
    assert len(pictures[0].bodies) == drawn({"robots": {"from": 2, "to": 9}}, 5)["robots"]


def test_fixed_seeds_are_those_of_the_first_end() -> None:
    built, _ = build(
        "emergency-exit", {**AGENTS, "seed": {"choice": [40, 50]}}, "fully-meshed", {}
    )
    assert list(built.fixed_seeds(3) or []) == [40, 41, 42]
    assert (
        build("arena", {"robots": {"from": 2, "to": 3}}, "fully-meshed", {})[
            0
        ].fixed_seeds(3)
        is None
    )


def test_the_probe_depends_on_ranges() -> None:
    """The trials of the probe have settings of their own."""
    one, other = (
        probe(*build("emergency-exit", settings, "fully-meshed", {})).digest
        for settings in ({}, AGENTS)
    )
    assert one != other
    assert (
        probe(*build("emergency-exit", dict(AGENTS), "fully-meshed", {})).digest == other
    )


class Host(HostingSimulator):
    """Decide for the controllers; the fitness is 1000 robots + the first byte of the genome."""

    settings_type = Settings
    inputs = outputs = 1
    owners = (0,)
    settings: Settings
    reset = step = outcome = Herd.outcome  # never called

    def host(self, kind: str, settings: Mapping[str, Any]) -> bool:
        self.prepared = (kind, settings["hidden"])
        return True

    def play_alone(self, genomes: Sequence[bytes], seed: int) -> Outcome:  # noqa: ARG002
        assert self.prepared == ("fully-meshed", 3)
        return Outcome([self.settings.robots * 1000 + genomes[0][0]], [])


def test_a_simulator_that_hosts_the_controller_is_prepared_for_each_drawn_setting(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    load = plugins.load
    monkeypatch.setattr(
        plugins, "load", lambda kind, name: Host if name == "host" else load(kind, name)
    )
    settings = {"robots": {"from": 1, "to": 9}}
    built, network = build("host", settings, "fully-meshed", {"hidden": 3})
    genomes = network.random(2, Stream(1))
    outcomes = evaluate(
        built, network, genomes, np.array([[0], [1]] * 20), np.arange(40, dtype=np.uint64)
    )
    assert outcomes.error == ""
    expected = [
        drawn(settings, seed)["robots"] * 1000 + genomes[seed % 2][0]
        for seed in range(40)
    ]
    assert outcomes.fitness[:, 0].tolist() == expected


# ---- refused


@pytest.mark.parametrize(
    ("settings", "line"),
    [
        (
            {"agents": {"from": 5, "to": 90}, "width": {"from": 10, "to": 20}},
            "115 agents, exits and blockades do not fit on 100 cells "
            "(with width = 10, agents = 90)",
        ),
        (
            {"width": {"from": 10, "to": 20}, "height": {"from": 15, "to": 30}},
            "width must not exceed height: a random field draws both coordinates from the width "
            "(with width = 20, height = 15)",
        ),
    ],
)
def test_contradicting_ends_are_refused_at_once(
    settings: dict[str, Any], line: str
) -> None:
    with pytest.raises(ConfigError) as caught:
        build("emergency-exit", settings, "fully-meshed", {})
    assert str(caught.value) == f"emergency-exit: {line}"


def test_inputs_metrics_and_participants_must_not_differ_by_trial() -> None:
    with pytest.raises(
        ConfigError,
        match=r"with gait = run the metrics are \('falls',\), not \(\) as with the ",
    ):
        herd(gait={"choice": ["walk", "run"]})
    with pytest.raises(
        ConfigError,
        match=r"with task = foraging the inputs are 15, not 10 as with the first ",
    ):
        build(
            "arena", {"task": {"choice": ["aggregation", "foraging"]}}, "fully-meshed", {}
        )
    with pytest.raises(
        ConfigError,
        match=r"^problem.settings: with defenders = 0, teams = 2 the participants are 2, not 1 ",
    ):
        build(
            "minisim",
            {"teams": {"from": 1, "to": 2}, "defenders": {"choice": [0]}},
            "fully-meshed",
            {},
        )


def test_settings_that_are_refused_between_the_ends_give_nan() -> None:
    """NaN, as whatever a simulator raises; the others of the batch are played."""
    varied = herd(robots={"from": 6, "to": 8})
    outcomes = evaluate(
        varied,
        NETWORK,
        NETWORK.random(1, Stream(1)),
        np.zeros((30, 1), int),
        np.arange(30, dtype=np.uint64),
    )
    numbers = [
        drawn({"robots": {"from": 6, "to": 8}}, seed)["robots"] for seed in range(30)
    ]
    assert np.isnan(outcomes.fitness[:, 0]).tolist() == [
        number == 7 for number in numbers
    ]
    line = "ConfigError: seven robots do not fit (with robots = 7)"
    assert outcomes.error == f"Herd, trial seed {numbers.index(7)}: {line}"


def test_some_combinations_of_many_ranges_are_tried() -> None:
    """All of four ranges; of more each end alone, and the last ends together."""
    tried: list[tuple[Any, ...]] = []

    def built(settings: dict[str, Any]) -> Simulator:
        tried.append(tuple(settings["free"].values()))
        return Herd(Settings())

    for count in (4, 6):
        tried.clear()
        Varied(
            {"free": {str(number): {"from": 0, "to": 1} for number in range(count)}},
            built,
        )
        if count == 4:
            assert sorted(tried) == list(itertools.product((0, 1), repeat=4))
        else:
            assert sorted(map(sum, tried)) == [0, *[1] * count, count]
