"""Settings that differ by trial: what may be written, what is drawn, and that a trial is that of the drawn settings."""

import itertools
import tomllib
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal

import msgspec
import numpy as np
import pytest
from msgspec import Meta

from zswarm import experiment, plugins, ranges
from zswarm.draws import Stream, derive_seed
from zswarm.errors import ConfigError
from zswarm.evaluate import build, evaluate, probe, turns
from zswarm.nets.fully_meshed import FullyMeshed
from zswarm.nets.fully_meshed import Settings as NetworkSettings
from zswarm.ot import trace
from zswarm.sims.emergency_exit import EmergencyExit
from zswarm.sims.simulator import Batch, HostingSimulator, Outcome, Simulator, Turn
from zswarm.varied import KEPT, Varied, drawn

AGENTS = {"agents": {"from": 5, "to": 15}}


class Wind(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    speed: Annotated[float, Meta(ge=0, le=10)] = 1.0


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    robots: Annotated[int, Meta(ge=1, le=9)] = 2
    mass: Annotated[float, Meta(gt=0)] = 1.0
    gait: Literal["walk", "run"] = "walk"
    wind: Wind = Wind()
    free: dict[str, Any] = {}


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
        return Turn(range(self.settings.robots), np.full((self.settings.robots, 1), seed % 5, np.float32))

    def step(self, actions: np.ndarray) -> None:
        assert actions.shape == (self.settings.robots, 1)

    def outcome(self) -> Outcome:
        return Outcome([self.settings.robots * 1000 + self.settings.mass], [])


NETWORK = FullyMeshed(NetworkSettings(hidden=1), 1, 1)


def herd(**settings: Any) -> Varied:
    whole = ranges.complete(settings, Settings, "it")
    return Varied(whole, lambda plain: Herd(msgspec.convert(plain, Settings)))


def played(simulator: str, settings: dict[str, Any], seeds: list[int]) -> list[bytes]:
    """The outcomes of random genomes, a trial of each on each seed."""
    built, network = build(simulator, settings, "fully-meshed", {})
    genomes = network.random(2, Stream(3))
    participants = np.repeat(np.arange(2), len(seeds))[:, None]
    outcomes = evaluate(built, network, genomes, participants, np.array(seeds * 2, np.uint64))
    assert outcomes.error == ""
    return [row.tobytes() for row in np.hstack([outcomes.fitness, outcomes.metrics])]


# ---- what may be written


def test_ranges_are_completed_as_their_setting_takes_numbers() -> None:
    """Whole ones of a float become floats, in tables of settings, too; a choice may be of anything; defaults are written out."""
    given = {
        "mass": {"from": 1, "to": 2},
        "robots": {"from": 1, "to": 9},
        "gait": {"choice": ["run", "walk", "run"]},
        "wind": {"speed": {"from": 0, "to": 10}},
        "free": {"gravity": {"from": 1, "to": 2.5}, "other": {"choice": [[1], {"a": 1}]}},
    }
    whole = ranges.complete(given, Settings, "it")
    assert msgspec.json.encode(whole, order="sorted") == msgspec.json.encode(
        {**given, "mass": {"from": 1.0, "to": 2.0}, "wind": {"speed": {"from": 0.0, "to": 10.0}}}, order="sorted"
    )
    assert ranges.complete(whole, Settings, "it") == whole
    assert ranges.complete({}, Settings, "it") == msgspec.to_builtins(Settings())


@pytest.mark.parametrize(
    ("written", "line"),
    [
        ("robots = { from = 0, to = 3 }", "it: robots: expected int >= 1 (in its range: 0)"),
        ("robots = { from = 3, to = 10 }", "it: robots: expected int <= 9 (in its range: 10)"),
        ("robots = { from = 1.5, to = 3 }", "it: robots: expected int, got float (in its range: 1.5)"),
        ("robots = { from = 3, to = 2 }", "it: robots: from 3 must not be above to 2"),
        ("robots = { from = 3, too = 4 }", "it: robots: expected { from = 5, to = 15 } or { choice = [5, 10] }, or one value"),
        ("robots = { from = 3 }", "it: robots: expected { from = 5, to = 15 } or { choice = [5, 10] }, or one value"),
        ("robots = { choice = [] }", "it: robots: choice: expected a list of 1 to 100 values, such as [5, 10]"),
        ("robots = { choice = 3 }", "it: robots: choice: expected a list of 1 to 100 values, such as [5, 10]"),
        ("robots = { choice = [3, '4'] }", "it: robots: expected int, got str (in its range: 4)"),
        (
            "robots = { choice = [3, { from = 1, to = 2 }] }",
            'it: robots: expected int, got object (in its range: {"from":1,"to":2})',
        ),
        ("mass = { from = 0, to = 1 }", "it: mass: expected float > 0.0 (in its range: 0)"),
        ("mass = { from = 1, to = inf }", "it: mass: to: expected a finite number, not inf; other values: choice = [...]"),
        ("mass = { from = nan, to = 1 }", "it: mass: from: expected a finite number, not nan; other values: choice = [...]"),
        ("mass = { from = true, to = 2 }", "it: mass: from: expected a finite number, not True; other values: choice = [...]"),
        (
            "free.a = { from = -1e308, to = 1e307 }",
            "it: free.a: from: expected a finite number, not -1e+308; other values: choice = [...]",
        ),
        (
            "gait = { from = 'run', to = 'walk' }",
            "it: gait: from: expected a finite number, not 'run'; other values: choice = [...]",
        ),
        (
            "gait = { choice = ['walk', 'rnu'] }",
            "it: gait: expected walk or run, not 'rnu' (did you mean 'run'?) (in its range: rnu)",
        ),
        ("wind.speed = { from = 1, to = 11 }", "it: wind.speed: expected float <= 10.0 (in its range: 11)"),
        (
            "wnid.speed = { from = 1, to = 11 }",
            "it: unknown key 'wnid' (did you mean 'wind'?); known are: robots, mass, gait, wind, free",
        ),
    ],
)
def test_what_is_no_range_is_refused_in_one_line(written: str, line: str) -> None:
    with pytest.raises(ConfigError) as caught:
        ranges.complete(tomllib.loads(written), Settings, "it")
    assert str(caught.value) == line


def test_a_range_in_a_file_is_refused_with_its_line(tmp_path: Any) -> None:
    path = tmp_path / "my.toml"
    text = experiment.find("emergency-exit").read_text()
    path.write_text(text.replace("agents = 10", "agents = { from = 0, to = 3 }"))
    assert "{ from" in path.read_text()
    number = next(at for at, line in enumerate(path.read_text().splitlines(), 1) if "{ from" in line)
    with pytest.raises(ConfigError) as caught:
        experiment.complete(experiment.load(path), str(path))
    assert str(caught.value) == f"{path}:{number}: problem.settings: agents: expected int >= 1 (in its range: 0)"


def test_only_the_problem_has_ranges() -> None:
    with pytest.raises(ConfigError, match="representation: hidden: expected int, got object"):
        loaded("representation.hidden={ from = 1, to = 3 }")


def loaded(*overrides: str) -> experiment.Experiment:
    path = experiment.find("emergency-exit")
    return experiment.complete(experiment.load(path, overrides), "it")


def test_a_range_is_set_changed_and_fixed_from_the_command_line() -> None:
    wide = "problem.settings.agents={ from = 5, to = 15 }"
    assert loaded(wide).problem.settings["agents"] == {"from": 5, "to": 15}
    assert loaded(wide, "problem.settings.agents.to=20").problem.settings["agents"] == {"from": 5, "to": 20}
    assert loaded(wide, "problem.settings.agents=7").problem.settings["agents"] == 7


def test_a_complete_experiment_with_ranges_is_read_as_it_was_written() -> None:
    whole = loaded("problem.settings.agents={ from = 5, to = 15 }", "problem.settings.exits={ choice = [2, 4] }")
    assert experiment.check(tomllib.loads(experiment.to_toml(whole)), "it") == whole


def test_a_study_compares_ranges_and_values() -> None:
    """As values of a grid and in a list, whose tables are else paths."""
    values = [10, {"from": 5, "to": 15}, {"choice": [5, 15]}]
    mapping = experiment.to_mapping(loaded())
    for study in (
        {"grid": {"problem.settings.agents": values}},
        {"list": [{"problem.settings.agents": value} for value in values]},
        {"list": [{"problem": {"settings": {"agents": value}}} for value in values]},
    ):
        whole = experiment.complete(experiment.check({**mapping, "study": study}, "it"), "it")
        told = [variant.experiment.problem.settings["agents"] for variant in experiment.variants(whole, "it")]
        assert told == values


# ---- what is drawn


def test_the_same_seed_draws_the_same_on_every_machine_and_whatever_else_is_drawn() -> None:
    """Numbers that never change, by the formulas of the document; a range more, or another order, changes no other."""
    settings = {"robots": {"from": 1, "to": 9}, "mass": {"from": 1.0, "to": 2.0}, "gait": {"choice": ["walk", "run"]}, "wind": 3}
    assert drawn(settings, 1) == DRAWN
    word = derive_seed(1, "settings robots")
    assert 1 + (9 * word >> 64) == DRAWN["robots"]
    reordered = dict(reversed(settings.items()))
    for seed in range(20):
        assert drawn(reordered, seed) == drawn(settings, seed)
        assert drawn({"robots": settings["robots"]}, seed) == {"robots": drawn(settings, seed)["robots"]}


DRAWN = {"robots": 3, "mass": 1.1319406877773202, "gait": "run", "wind": 3}


def test_draws_are_even_and_reach_whole_ends() -> None:
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
        ("arena", {"robots": {"from": 2, "to": 20}, "side": {"from": 2, "to": 6}, "steps": 20}),
        ("minisim", {"robots": {"from": 1, "to": 9}, "defenders": {"choice": [0, 3]}, "steps": 20}),
    ],
)
def test_a_trial_is_that_of_the_drawn_settings(simulator: str, settings: dict[str, Any]) -> None:
    """Bit for bit; the same in a batch, in another order, and by turns. More seeds than simulators are kept."""
    seeds = list(range(1000, 1000 + KEPT + 3))
    together = played(simulator, settings, seeds)
    expected = [
        played(simulator, drawn(ranges.complete(settings, settings_type(simulator), "it"), seed), [seed]) for seed in seeds
    ]
    assert together == [row for of_genome in zip(*expected, strict=True) for row in of_genome]
    assert played(simulator, settings, seeds[::-1]) == together[: len(seeds)][::-1] + together[len(seeds) :][::-1]
    assert len(set(together)) > len(seeds) / 2


def settings_type(simulator: str) -> type[msgspec.Struct]:
    kind: type[msgspec.Struct] = plugins.load("simulator", simulator).settings_type
    return kind


def test_the_first_end_alone_is_the_same_as_a_value() -> None:
    seeds = [3, 4]
    assert played("emergency-exit", {"agents": {"from": 9, "to": 9}}, seeds) == played("emergency-exit", {"agents": 9}, seeds)


def test_without_ranges_nothing_is_drawn() -> None:
    assert type(build("emergency-exit", {"agents": 5}, "fully-meshed", {})[0]) is EmergencyExit


class Watched(Herd):
    """Notes the trial that progress names when it is played."""

    progress = np.zeros(2, np.int64)
    noted: ClassVar[list[tuple[int, int]]] = []
    stop_after = 10**9

    def reset(self, seed: int) -> Turn:
        self.noted.append((seed, int(self.progress[0])))
        self.progress[1] = len(self.noted) == self.stop_after
        return super().reset(seed)


@pytest.mark.parametrize("stop_after", [3, 10**9])
def test_progress_names_the_trial_that_is_played_and_stops_before_the_next(
    stop_after: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Those with the same settings are played one after another; so each simulator is set up once for a batch."""
    monkeypatch.setattr(Watched, "noted", [])
    monkeypatch.setattr(Watched, "stop_after", stop_after)
    Watched.progress[:] = 0
    built: list[int] = []

    def build_one(plain: dict[str, Any]) -> Simulator:
        built.append(plain["robots"])
        return Watched(msgspec.convert(plain, Settings))

    varied = Varied(ranges.complete({"robots": {"choice": list(range(1, 6)) * 10}}, Settings, "it"), build_one)
    monkeypatch.setattr("zswarm.varied.KEPT", 2)
    built.clear()
    seeds = np.array([*range(20), *range(20)], np.uint64)
    outcomes = evaluate(varied, NETWORK, NETWORK.random(1, Stream(1)), np.zeros((40, 1), int), seeds, Watched.progress)
    assert [seed for seed, _ in Watched.noted] == [int(seeds[trial]) for _, trial in Watched.noted]
    played = [trial for _, trial in Watched.noted]
    assert len(set(played)) == len(played) == min(stop_after, 40)
    assert np.isfinite(outcomes.fitness[played]).all()
    assert np.isfinite(outcomes.fitness).sum() == len(played)
    assert len(built) == len(set(built))


def test_a_kernel_plays_several_trials_at_once_and_stops_between(monkeypatch: pytest.MonkeyPatch) -> None:
    """More of them where they are short; progress names the first, as of trials that are played side by side."""
    progress, calls = np.zeros(2, np.int64), []
    play_lanes = EmergencyExit.play_lanes

    def watched(self: EmergencyExit, step_lanes: Any, step: Any, batch: Batch) -> None:
        calls.append((int(progress[0]), len(batch.seeds)))
        progress[1] = len(calls) == 3
        play_lanes(self, step_lanes, step, batch)

    built, network = build("emergency-exit", AGENTS, "fully-meshed", {})
    assert isinstance(built, Varied)
    monkeypatch.setattr(EmergencyExit, "play_lanes", watched)
    monkeypatch.setattr(built, "took", lambda _seconds: setattr(built, "together", 2 * built.together))
    other = next(seed for seed in range(8, 99) if drawn(AGENTS, seed) != drawn(AGENTS, 7))
    seeds = np.array([7, other] * 10, np.uint64)
    outcomes = evaluate(built, network, network.random(1, Stream(1)), np.zeros((20, 1), int), seeds, progress)
    assert calls == [(0, 1), (2, 2), (6, 4)]
    assert np.isfinite(outcomes.fitness[:, 0]).tolist() == [trial % 2 == 0 and trial < 14 for trial in range(20)]


def test_as_many_trials_are_played_at_once_as_take_some_milliseconds() -> None:
    varied = herd(robots={"from": 1, "to": 2})
    for seconds, together in [*((0.001, 2**more) for more in range(1, 9)), (0.001, 256), (0.03, 128), (0.03, 64)]:
        varied.took(seconds)
        assert varied.together == together
    for _ in range(9):
        varied.took(1.0)
    assert varied.together == 1


def test_the_number_of_agents_may_differ_by_trial() -> None:
    """In turns each has a state of its own, and a picture all of them."""
    varied, genomes = herd(robots={"from": 1, "to": 5}), NETWORK.random(1, Stream(1))
    assert varied.agents == (1, 5)
    seeds = np.arange(30, dtype=np.uint64)
    outcomes = evaluate(varied, NETWORK, genomes, np.zeros((30, 1), int), seeds)
    numbers = [drawn({"robots": {"from": 1, "to": 5}}, seed)["robots"] for seed in range(30)]
    assert outcomes.fitness[:, 0].tolist() == [1000 * number + 1 for number in numbers]
    assert set(numbers) == {1, 2, 3, 4, 5}
    parameters = NETWORK.parameters(genomes)
    assert [len(next(turns(varied, NETWORK, parameters, seed)).agents) for seed in range(30)] == numbers
    arena, network = build("arena", {"robots": {"from": 2, "to": 9}, "steps": 2}, "fully-meshed", {})
    pictures = trace.record(arena, network, network.random(1, Stream(1)), 5).frames
    assert len(pictures[0].bodies) == drawn({"robots": {"from": 2, "to": 9}}, 5)["robots"]


def test_the_problem_s_seeds_are_those_of_the_first_end() -> None:
    built, _ = build("emergency-exit", {**AGENTS, "seed": {"choice": [40, 50]}}, "fully-meshed", {})
    assert list(built.fixed_seeds(3) or []) == [40, 41, 42]
    assert build("arena", {"robots": {"from": 2, "to": 3}}, "fully-meshed", {})[0].fixed_seeds(3) is None


def test_servers_are_compared_with_ranges_too() -> None:
    """The trials of the probe have settings of their own."""
    one, other = (probe(*build("emergency-exit", settings, "fully-meshed", {})).digest for settings in ({}, AGENTS))
    assert one != other
    assert probe(*build("emergency-exit", dict(AGENTS), "fully-meshed", {})).digest == other


class Host(HostingSimulator):
    """It decides for the controllers itself; the fitness is its robots and the first byte of the genome."""

    settings_type = Settings
    inputs = outputs = 1
    owners = (0,)
    settings: Settings
    reset = step = outcome = Herd.outcome  # never called

    def host(self, kind: str, settings: Mapping[str, Any]) -> bool:
        self.prepared = (kind, settings["hidden"])
        return True

    def play_alone(self, genomes: Sequence[bytes], seed: int) -> Outcome:  # noqa: ARG002  nothing is drawn
        assert self.prepared == ("fully-meshed", 3)
        return Outcome([self.settings.robots * 1000 + genomes[0][0]], [])


def test_a_simulator_that_decides_itself_is_prepared_with_each_of_its_settings(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    load = plugins.load
    monkeypatch.setattr(plugins, "load", lambda kind, name: Host if name == "host" else load(kind, name))
    settings = {"robots": {"from": 1, "to": 9}}
    built, network = build("host", settings, "fully-meshed", {"hidden": 3})
    genomes = network.random(2, Stream(1))
    outcomes = evaluate(built, network, genomes, np.array([[0], [1]] * 20), np.arange(40, dtype=np.uint64))
    assert outcomes.error == ""
    expected = [drawn(settings, seed)["robots"] * 1000 + genomes[seed % 2][0] for seed in range(40)]
    assert outcomes.fitness[:, 0].tolist() == expected


# ---- refused


@pytest.mark.parametrize(
    ("settings", "line"),
    [
        (
            {"agents": {"from": 5, "to": 90}, "width": {"from": 10, "to": 20}},
            "emergency-exit: 115 agents, exits and blockades do not fit on 100 cells (with width = 10, agents = 90)",
        ),
        (
            {"width": {"from": 10, "to": 20}, "height": {"from": 15, "to": 30}},
            "emergency-exit: width must not exceed height: a random field draws both coordinates from the width "
            "(with width = 20, height = 15)",
        ),
    ],
)
def test_ends_that_do_not_go_together_are_refused_at_once(settings: dict[str, Any], line: str) -> None:
    with pytest.raises(ConfigError) as caught:
        build("emergency-exit", settings, "fully-meshed", {})
    assert str(caught.value) == line


def test_what_a_network_is_built_for_must_not_differ_by_trial() -> None:
    with pytest.raises(
        ConfigError, match=r"^problem.settings: with gait = run the metrics are \('falls',\), not \(\) as with the "
    ):
        herd(gait={"choice": ["walk", "run"]})
    with pytest.raises(
        ConfigError, match=r"^problem.settings: with task = foraging the inputs are 15, not 10 as with the first "
    ):
        build("arena", {"task": {"choice": ["aggregation", "foraging"]}}, "fully-meshed", {})
    with pytest.raises(ConfigError, match=r"^problem.settings: with defenders = 0, teams = 2 the participants are 2, not 1 "):
        build("minisim", {"teams": {"from": 1, "to": 2}, "defenders": {"choice": [0]}}, "fully-meshed", {})


def test_settings_that_are_refused_between_the_ends_are_an_outcome() -> None:
    """NaN, as whatever a simulator raises; the others of the batch are played."""
    varied = herd(robots={"from": 6, "to": 8})
    outcomes = evaluate(varied, NETWORK, NETWORK.random(1, Stream(1)), np.zeros((30, 1), int), np.arange(30, dtype=np.uint64))
    numbers = [drawn({"robots": {"from": 6, "to": 8}}, seed)["robots"] for seed in range(30)]
    assert np.isnan(outcomes.fitness[:, 0]).tolist() == [number == 7 for number in numbers]
    line = "ConfigError: seven robots do not fit (with robots = 7)"
    assert outcomes.error == f"Herd, trial seed {numbers.index(7)}: {line}"


def test_some_combinations_of_many_ranges_are_tried() -> None:
    """All of four; of more each end alone and the last ends together. A server sets each of them up."""
    tried: list[tuple[Any, ...]] = []

    def built(settings: dict[str, Any]) -> Simulator:
        tried.append(tuple(settings["free"].values()))
        return Herd(Settings())

    for count in (4, 6):
        tried.clear()
        Varied({"free": {str(number): {"from": 0, "to": 1} for number in range(count)}}, built)
        if count == 4:
            assert sorted(tried) == list(itertools.product((0, 1), repeat=4))
        else:
            assert sorted(map(sum, tried)) == [0, *[1] * count, count]
