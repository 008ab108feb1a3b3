"""Test the evaluation of batches: who plays, simulators that misbehave, and stopping a batch."""

import signal
from collections.abc import Callable
from typing import Annotated, Any

import msgspec
import numpy as np
import pytest
from msgspec import Meta

from zswarm.errors import ConfigError, EvaluationError, UnknownPlugin
from zswarm.evaluate import TrialOutcomes, build, evaluate
from zswarm.kernels.random import Stream
from zswarm.nets.fully_meshed import FullyMeshed, FullyMeshedSettings
from zswarm.plugins import registry as plugins
from zswarm.probe import probe
from zswarm.protocol.messages import PROBE_DIGEST, PROBE_TRIALS
from zswarm.sims.minisim import Minisim
from zswarm.sims.raised import MAX_ERROR_TEXT
from zswarm.sims.simulator import KernelBatch, Outcome, Simulator, Turn
from zswarm.testing import check_simulator

CANONICAL = np.array([np.nan]).tobytes()
OTHER_NAN = np.array([0xFFF8000000000123], np.uint64).view(np.float64)[0]
RAISES, INFINITE, ODD_NAN, BAD_SHAPE, RAISES_EMPTY, LAST_TRIAL = (
    900,
    901,
    902,
    903,
    904,
    905,
)


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    rounds: Annotated[int, Meta(ge=1)] = 3


class Duel(Simulator):
    """Two robots of different participants, each of which observes the other's last action.

    Fitness is a robot's own sum minus the other's. The first robot acts first. The seed determines
    the first observation; some seeds misbehave.
    """

    settings_type = Settings
    metrics = ("turns", "seed")
    participants = 2
    inputs = outputs = 1
    owners = (0, 1)
    settings: Settings
    progress: np.ndarray | None = None  # of the batch, where this simulator is to stop it
    played: list[int]

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings)
        self.played = []

    def reset(self, seed: int) -> Turn:
        self.played.append(seed)
        self._seed, self._turns, self._sums, self._seen = (
            seed,
            0,
            [0.0, 0.0],
            np.float32(seed % 7 / 7),
        )
        if seed == RAISES:
            raise RuntimeError("the wall fell down" + "!" * 1000)
        return self._turn()

    def step(self, actions: np.ndarray) -> Turn | None:
        assert actions.shape == (1, 1)
        assert actions.dtype == np.float32
        self._sums[self._turns % 2] += float(actions[0, 0])
        self._seen = actions[0, 0]
        self._turns += 1
        return self._turn() if self._turns < 2 * self.settings.rounds else None

    def outcome(self) -> Outcome:
        first, second = self._sums
        if self.progress is not None and self._seed == LAST_TRIAL:
            self.progress[1] = 1
        if self._seed == RAISES_EMPTY:
            raise KeyError
        if self._seed == INFINITE:
            return Outcome([np.inf, 1.0], [np.float64("-inf"), 2.0])
        if self._seed == ODD_NAN:
            return Outcome([OTHER_NAN, 1.0], [OTHER_NAN, 2.0])
        return Outcome([first - second, second - first], [self._turns, self._seed])

    def _turn(self) -> Turn:
        width = 2 if self._seed == BAD_SHAPE else 1
        return Turn((self._turns % 2,), np.full((1, width), self._seen, np.float32))


@pytest.fixture
def duel() -> Duel:
    return Duel(Settings())


@pytest.fixture
def network() -> FullyMeshed:
    return FullyMeshed(FullyMeshedSettings(hidden=1), 1, 1)


def play(
    duel: Duel,
    network: FullyMeshed,
    pairs: list[list[int]],
    seeds: list[int],
    **more: Any,
) -> TrialOutcomes:
    return evaluate(
        duel,
        network,
        network.random(3, Stream(1)),
        np.array(pairs),
        np.array(seeds, np.uint64),
        **more,
    )


# ---- outcomes


def test_each_participant_gets_the_fitness_of_its_own_robot(
    duel: Duel, network: FullyMeshed
) -> None:
    outcomes = play(duel, network, [[0, 1], [1, 0], [2, 2]], [5, 5, 5])
    assert outcomes.fitness.shape == (3, 2)
    assert outcomes.fitness.dtype == np.float64
    assert (outcomes.fitness[:, 0] == -outcomes.fitness[:, 1]).all()
    assert abs(outcomes.fitness[0, 0]) > 0.1, "the first two differ"
    assert not np.array_equal(outcomes.fitness[0], outcomes.fitness[1]), (
        "who begins matters"
    )
    assert outcomes.metrics.tolist() == [[6, 5]] * 3
    assert outcomes.error == ""


def test_the_state_of_a_robot_lasts_a_trial_and_no_longer(network: FullyMeshed) -> None:
    """Reset state between trials.

    A long trial begins like a short one, and a trial's outcome does not depend on earlier trials.
    """
    long = Duel(Settings(rounds=4))
    alone = play(long, network, [[0, 1]], [3])
    after_others = play(long, network, [[2, 0], [1, 2], [0, 1]], [1, 2, 3])
    assert after_others.fitness[2].tobytes() == alone.fitness[0].tobytes()
    by_hand = np.zeros(2)
    states, seen = (
        np.zeros((2, network.state_size), np.float32),
        np.full(1, 3 / 7, np.float32),
    )
    parameters = network.parameters(network.random(3, Stream(1)))
    for turn in range(8):
        action = np.empty(1, np.float32)
        FullyMeshed.step(parameters[turn % 2], states[turn % 2], seen, action)
        by_hand[turn % 2] += action[0]
        seen = action
    assert alone.fitness[0, 0] == by_hand[0] - by_hand[1]


def test_seeds_of_64_bits_reach_the_simulator_unchanged(
    duel: Duel, network: FullyMeshed
) -> None:
    play(duel, network, [[0, 1], [0, 1]], [2**64 - 1, 2**63])
    assert duel.played == [2**64 - 1, 2**63]
    assert all(type(seed) is int for seed in duel.played)


def test_zero_trials_give_empty_outcomes(duel: Duel, network: FullyMeshed) -> None:
    outcomes = evaluate(
        duel, network, [], np.zeros((0, 2), np.int64), np.zeros(0, np.uint64)
    )
    assert outcomes.fitness.shape == (0, 2)
    assert outcomes.metrics.shape == (0, 2)


@pytest.mark.parametrize("settings", [{"field": "random"}, {"field": "stadium"}])
def test_an_empty_batch_leaves_no_state_in_a_kernel(settings: dict[str, Any]) -> None:
    """Trials that come later find the fields that they need."""
    simulator, network = build(
        "emergency-exit", settings | {"steps": 3}, "fully-meshed", {}
    )
    none = evaluate(
        simulator, network, [], np.zeros((0, 1), np.int64), np.zeros(0, np.uint64)
    )
    assert (none.fitness.shape, none.metrics.shape) == ((0, 1), (0, 2))
    genomes, one = (
        network.random(1, Stream(1)),
        (np.zeros((1, 1), np.int64), np.ones(1, np.uint64)),
    )
    fresh, _ = build("emergency-exit", settings | {"steps": 3}, "fully-meshed", {})
    assert (
        evaluate(simulator, network, genomes, *one).fitness
        == evaluate(fresh, network, genomes, *one).fitness
    )


# ---- what a simulator does wrong


def test_a_trial_that_raises_is_nan_and_the_others_continue(
    duel: Duel, network: FullyMeshed
) -> None:
    outcomes = play(duel, network, [[0, 1]] * 3, [1, RAISES, 2])
    assert outcomes.fitness[1].tobytes() == CANONICAL * 2
    assert outcomes.metrics[1].tobytes() == CANONICAL * 2
    assert np.isfinite(outcomes.fitness[[0, 2]]).all()
    assert outcomes.error.startswith(
        "Duel, trial seed 900: RuntimeError: the wall fell down!"
    )
    assert len(outcomes.error) == MAX_ERROR_TEXT


def test_the_first_error_of_a_batch_is_reported(duel: Duel, network: FullyMeshed) -> None:
    assert (
        play(duel, network, [[0, 1]] * 2, [RAISES_EMPTY, RAISES]).error
        == "Duel, trial seed 904: KeyError: "
    )


@pytest.mark.parametrize("seed", [INFINITE, ODD_NAN])
def test_a_nonfinite_number_becomes_the_canonical_nan(
    duel: Duel, network: FullyMeshed, seed: int
) -> None:
    outcomes = play(duel, network, [[0, 1]], [seed])
    assert outcomes.fitness.tobytes() == CANONICAL + np.float64(1).tobytes()
    assert outcomes.metrics.tobytes() == CANONICAL + np.float64(2).tobytes()
    number = "inf" if seed == INFINITE else "nan"
    assert (
        outcomes.error
        == f"Duel, trial seed {seed}: fitness must be finite, not [{number}, 1.0]"
    )


def test_observations_of_a_wrong_shape_are_the_trials_error(
    duel: Duel, network: FullyMeshed
) -> None:
    outcomes = play(duel, network, [[0, 1]], [BAD_SHAPE])
    assert np.isnan(outcomes.fitness).all()
    assert (
        outcomes.error == "Duel, trial seed 903: observations must be (1, 1), not (1, 2)"
    )


class Wrong(Duel):
    """Do what an instance is told to do instead of what it should."""

    wrong: dict[str, Callable[[], Any]]

    def reset(self, seed: int) -> Turn:
        turn = super().reset(seed)
        return self.wrong["reset"]() if "reset" in self.wrong else turn

    def step(self, actions: np.ndarray) -> Turn | None:
        following = super().step(actions)
        return self.wrong["step"]() if "step" in self.wrong else following

    def outcome(self) -> Outcome:
        return self.wrong["outcome"]() if "outcome" in self.wrong else super().outcome()


def raising(error: BaseException) -> Callable[[], Any]:
    def call() -> None:
        raise error

    return call


@pytest.mark.parametrize(
    ("method", "answer", "text"),
    [
        ("reset", lambda: None, "reset must return a Turn: an agent must act"),
        (
            "reset",
            lambda: ((0,), np.zeros((1, 1))),
            "reset and step must return a Turn, and step None at the end; not ((0,), arr",
        ),
        (
            "step",
            lambda: 1,
            "reset and step must return a Turn, and step None at the end; not 1",
        ),
        (
            "step",
            lambda: Turn((), np.zeros((0, 1))),
            "a turn must name an agent; a trial that is over returns None",
        ),
        (
            "step",
            lambda: Turn((2,), np.zeros((1, 1))),
            "agents must be in range(0, 2), not [2]",
        ),
        (
            "step",
            lambda: Turn((-1,), np.zeros((1, 1))),
            "agents must be in range(0, 2), not [-1]",
        ),
        (
            "step",
            lambda: Turn((1,), np.full((1, 1), np.nan)),
            "observations must be finite; number 0 of agent 1 is nan",
        ),
        (
            "step",
            lambda: Turn((1,), np.full((1, 1), -np.inf)),
            "observations must be finite; number 0 of agent 1 is -inf",
        ),
        (
            "step",
            lambda: Turn((1,), np.zeros((1, 1))),
            "the trial continues after 1,000 turns: step must return None when it is over",
        ),
        (
            "step",
            raising(SystemExit(7)),
            "SystemExit: 7 (a simulator ends a trial by returning None, and never its process)",
        ),
        (
            "step",
            raising(GeneratorExit("x")),
            "GeneratorExit: x (a simulator ends a trial by returning None, and never its process)",
        ),
        ("outcome", lambda: None, "outcome must return an Outcome, not None"),
        (
            "outcome",
            lambda: Outcome([1.0], [0.0, 0.0]),
            "an outcome must have 2 fitness numbers and 2 metrics, not 1 and 2",
        ),
        (
            "outcome",
            lambda: Outcome(["a", 1.0], [0.0, 0.0]),
            "ValueError: could not convert string to float: ",
        ),
    ],
)
def test_a_broken_contract_is_the_trials_outcome_and_named(
    method: str,
    answer: Callable[[], Any],
    text: str,
    network: FullyMeshed,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Report what was expected, what was returned and the seed to replay it with.

    Later trials are unaffected.
    """
    monkeypatch.setattr("zswarm.sims.turns.MAX_TURNS", 1000)
    wrong = Wrong(Settings())
    wrong.wrong = {method: answer}
    outcomes = play(wrong, network, [[0, 1]], [5])
    assert np.isnan(outcomes.fitness).all()
    assert outcomes.error.startswith(f"Wrong, trial seed 5: {text}")
    wrong.wrong = {}
    assert (
        play(wrong, network, [[0, 1]], [5]).fitness.tobytes()
        == play(Duel(Settings()), network, [[0, 1]], [5]).fitness.tobytes()
    )


def test_a_keyboard_interrupt_is_an_outcome_only_if_sigint_is_ignored(
    network: FullyMeshed,
) -> None:
    wrong = Wrong(Settings())
    wrong.wrong = {"step": raising(KeyboardInterrupt())}
    with pytest.raises(KeyboardInterrupt):
        play(wrong, network, [[0, 1]], [5])
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        assert play(wrong, network, [[0, 1]], [5]).error.startswith(
            "Wrong, trial seed 5: KeyboardInterrupt: "
        )
    finally:
        signal.signal(signal.SIGINT, before)


def test_memory_errors_and_faults_are_not_outcomes(network: FullyMeshed) -> None:
    for error in (MemoryError(), EvaluationError("its program ended")):
        wrong = Wrong(Settings())
        wrong.wrong = {"step": raising(error)}
        with pytest.raises(type(error)):
            play(wrong, network, [[0, 1]], [5])


def test_a_compiled_simulator_that_raises_fails_in_the_guilty_trials_alone() -> None:
    """Whatever trials are beside them in a batch."""
    simulator, network = build("minisim", {}, "fully-meshed", {})
    genomes, participants = network.random(2, Stream(1)), np.array([[0], [1], [0], [1]])
    seeds = np.array([1, 2, 3, 4], np.uint64)
    sound = evaluate(simulator, network, genomes, participants, seeds)
    played = Minisim.play_lanes

    class Raises(Minisim):
        def play_lanes(self, step_lanes: Any, step: Any, batch: KernelBatch) -> None:
            if 3 in batch.seeds:
                raise RuntimeError("no seed 3")
            played(self, step_lanes, step, batch)

    outcomes = evaluate(Raises(simulator.settings), network, genomes, participants, seeds)  # type: ignore[arg-type]
    assert np.isnan(outcomes.fitness[2, 0])
    assert outcomes.error == "Raises, trial seed 3: RuntimeError: no seed 3"
    others = [0, 1, 3]
    assert outcomes.fitness[others].tobytes() == sound.fitness[others].tobytes()
    assert outcomes.metrics[others].tobytes() == sound.metrics[others].tobytes()


# ---- what is asked wrongly


@pytest.mark.parametrize("pairs", [[[0, 3]], [[-1, 0]], [[0, 2**40]]])
def test_a_participant_that_is_not_among_the_genomes_is_refused(
    pairs: list[list[int]], duel: Duel, network: FullyMeshed
) -> None:
    with pytest.raises(ValueError, match="a participant is not among the 3 genomes"):
        play(duel, network, pairs, [1])
    assert duel.played == []


def test_participants_of_a_wrong_shape_are_refused(
    duel: Duel, network: FullyMeshed
) -> None:
    for pairs in ([[0]], [[0, 1, 2]], [[0, 1], [0, 1]]):
        with pytest.raises(ValueError, match=r"participants must be \(1, 2\), not"):
            play(duel, network, pairs, [1])


def test_a_genome_that_does_not_fit_is_refused(duel: Duel, network: FullyMeshed) -> None:
    with pytest.raises(ValueError, match="a genome has 3 bytes"):
        evaluate(
            duel, network, [b"abc"], np.zeros((1, 2), np.int64), np.zeros(1, np.uint64)
        )


# ---- progress


def test_progress_shows_the_trial_that_runs_and_a_stop_ends_before_the_next(
    duel: Duel, network: FullyMeshed
) -> None:
    duel.progress = np.array([77, 0])
    outcomes = play(
        duel, network, [[0, 1]] * 4, [1, LAST_TRIAL, 2, 3], progress=duel.progress
    )
    assert duel.played == [1, LAST_TRIAL]
    assert np.isfinite(outcomes.fitness[:2]).all()
    assert np.isnan(outcomes.fitness[2:]).all()
    assert duel.progress.tolist() == [2, 1]


def test_a_batch_that_is_stopped_already_plays_nothing(
    duel: Duel, network: FullyMeshed
) -> None:
    play(duel, network, [[0, 1]], [1], progress=np.array([0, 1]))
    assert duel.played == []


def test_a_compiled_batch_is_stopped_too() -> None:
    simulator, network = build("minisim", {}, "fully-meshed", {})
    genomes = network.random(1, Stream(1))
    progress = np.array([5, 0])
    evaluate(
        simulator,
        network,
        genomes,
        np.zeros((3, 1), np.int64),
        np.arange(3, dtype=np.uint64),
        progress,
    )
    assert progress.tolist() == [2, 0]
    progress = np.array([0, 1])
    stopped = evaluate(
        simulator,
        network,
        genomes,
        np.zeros((3, 1), np.int64),
        np.arange(3, dtype=np.uint64),
        progress,
    )
    assert np.isnan(stopped.fitness).all()


# ---- building


def test_parts_are_built_to_fit_each_other() -> None:
    simulator, network = build("minisim", {"robots": 3}, "fully-meshed", {"hidden": 5})
    assert isinstance(simulator, Minisim)
    assert isinstance(network, FullyMeshed)
    assert (network.inputs, network.outputs, network.neurons) == (9, 2, 7)
    assert len(simulator.owners) == 3


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("minisin", {}, "fully-meshed", {}), "unknown simulator 'minisin'"),
        (("minisim", {}, "fully-mesh", {}), "unknown representation 'fully-mesh'"),
        (
            ("minisim", {"robot": 1}, "fully-meshed", {}),
            "problem.settings: unknown key 'robot'",
        ),
        (
            ("minisim", {}, "fully-meshed", {"hidden": "2"}),
            "representation: hidden: expected int, got str",
        ),
    ],
)
def test_parts_that_cannot_be_built_are_a_config_error(
    arguments: tuple[Any, ...], text: str
) -> None:
    with pytest.raises(ConfigError, match=text) as refusal:
        build(*arguments)
    assert isinstance(refusal.value, UnknownPlugin) == text.startswith("unknown ")


def test_a_simulator_that_cannot_be_set_up_is_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Broken(Duel):
        def __init__(self, settings: Settings) -> None:
            raise OSError(f"no map for {settings.rounds} rounds")

    installed = plugins.load
    monkeypatch.setattr(
        plugins,
        "load",
        lambda kind, name: Broken if kind == "simulator" else installed(kind, name),
    )
    with pytest.raises(
        ConfigError,
        match="simulator 'broken' cannot be set up: OSError: no map for 3 rounds",
    ):
        build("broken", {}, "fully-meshed", {})


# ---- the check of the contract


class OwnersMissOne(Duel):
    owners = (0, 0)


class NamesTooMany(Duel):
    sensors = ("a", "b")


class NoInputs(Duel):
    inputs = 0


class Carried(Duel):
    """Something is left over from one trial to the next."""

    carried = 0.0

    def reset(self, seed: int) -> Turn:
        type(self).carried += 1
        return super().reset(seed)

    def outcome(self) -> Outcome:
        return Outcome([self.carried, 0.0], [0.0, 0.0])


class WrongType(Duel):
    def _turn(self) -> Turn:
        return Turn((0,), np.zeros((1, 1)))


class WrongShape(Duel):
    def _turn(self) -> Turn:
        return Turn((0, 1), np.zeros((1, 1), np.float32))


class UnknownAgent(Duel):
    def _turn(self) -> Turn:
        return Turn((2,), np.zeros((1, 1), np.float32))


class NobodyActs(Duel):
    def _turn(self) -> Turn:
        return Turn((), np.zeros((0, 1), np.float32))


class OneFitness(Duel):
    def outcome(self) -> Outcome:
        return Outcome([1.0], [1.0, 2.0])


class NotFinite(Duel):
    def outcome(self) -> Outcome:
        return Outcome([1.0, np.inf], [1.0, 2.0])


class ChangesActions(Duel):
    def step(self, actions: np.ndarray) -> Turn | None:
        following = super().step(actions)
        actions[:] = 0
        return following


class BadSeeds(Duel):
    def fixed_seeds(self, trials: int) -> list[int]:
        return [-1] * trials


def drawing_elsewhere(self: Minisim, step: Any, batch: KernelBatch) -> None:
    Minisim.play(self, step, batch)
    batch.fitness[:] += 1e-12


def deaf(self: Minisim, step: Any, batch: KernelBatch) -> None:
    batch.progress[1] = 0
    Minisim.play(self, step, batch)


def drifting_aside(self: Minisim, step_lanes: Any, step: Any, batch: KernelBatch) -> None:
    Minisim.play_lanes(self, step_lanes, step, batch)
    batch.fitness[:] += 1e-12


def deaf_aside(self: Minisim, step_lanes: Any, step: Any, batch: KernelBatch) -> None:
    batch.progress[1] = 0
    Minisim.play_lanes(self, step_lanes, step, batch)


def test_a_sound_simulator_passes_the_check() -> None:
    check_simulator(Duel)
    check_simulator(Duel, {"rounds": 1})


@pytest.mark.parametrize(
    ("broken", "text"),
    [
        (OwnersMissOne, "owners must name each participant"),
        (NamesTooMany, "sensors must be empty or 1 names, not 2"),
        (NoInputs, "inputs must be an int of at least 1, not 0"),
        (Carried, "played again, after other trials, has another outcome"),
        (WrongType, "observations must be a float32 array, not float64"),
        (WrongShape, r"observations must be \(2, 1\), not \(1, 1\)"),
        (UnknownAgent, r"agents must be in range\(0, 2\), not \[2\]"),
        (NobodyActs, "a turn must name an agent"),
        (OneFitness, "fitness must be 2 numbers, not 1"),
        (NotFinite, "fitness must be finite"),
        (ChangesActions, "must not change the actions"),
        (BadSeeds, "fixed_seeds"),
        (
            type("Drifting", (Minisim,), {"play": drawing_elsewhere}),
            "the turns and the compiled form differ",
        ),
        (
            type("Deaf", (Minisim,), {"play": deaf}),
            "Deaf.play must end before the next trial",
        ),
        (
            type("Drifting", (Minisim,), {"play_lanes": drifting_aside}),
            "play_lanes: seed 0 has another outcome than in play",
        ),
        (
            type("Deaf", (Minisim,), {"play_lanes": deaf_aside}),
            "Deaf.play_lanes must end before the next trial",
        ),
    ],
)
def test_the_check_names_what_is_broken(broken: type[Simulator], text: str) -> None:
    with pytest.raises(AssertionError, match=text):
        check_simulator(broken)


# ---- the probe --------------------------------------------------------------------------


def built(rounds: int = 3) -> tuple[Duel, FullyMeshed]:
    simulator = Duel(Settings(rounds=rounds))
    network = FullyMeshed(FullyMeshedSettings(hidden=1), 1, 1)
    return simulator, network


def test_a_probe_has_a_digest_for_each_trial() -> None:
    whole = probe(*built(), budget_s=1e9).digest
    assert len(whole) == PROBE_TRIALS * PROBE_DIGEST
    assert len({whole[at : at + 8] for at in range(0, len(whole), 8)}) == PROBE_TRIALS
    assert probe(*built(), 3, budget_s=1e9).digest == whole[: 3 * PROBE_DIGEST]


def test_a_probe_of_long_trials_has_fewer_and_at_least_one() -> None:
    """No time for a second one."""
    assert probe(*built(), budget_s=0.0).digest == probe(*built()).digest[:PROBE_DIGEST]


def test_one_trial_is_played_of_a_simulator_that_is_not_repeatable() -> None:
    simulator, network = built()
    simulator.repeatable = False
    found = probe(simulator, network)
    assert (found.digest, len(simulator.played)) == (b"", 1)
    assert found.trial_s > 0.0
