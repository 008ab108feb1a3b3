"""The check that an optimizer keeps its contract."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import msgspec
import numpy as np

from zswarm.config.decode import convert
from zswarm.kernels.random import Stream
from zswarm.nets.representation import Representation
from zswarm.ot.optimizers.optimizer import Optimizer, Told
from zswarm.testing.rules import (
    checking,
    fully_meshed,
    require,
    require_accepted,
    require_raises,
)

DECISIONS = 5


def check_optimizer(
    optimizer_class: type[Optimizer],
    settings: Mapping[str, Any] | None = None,
    *,
    representation: Representation | None = None,
    generations: int = 25,
) -> None:
    """Evolve small networks towards zero weights and check the contract of ``Optimizer``.

    - ``ask`` and ``tell`` refuse a wrong order and wrong shapes, and change nothing they are given.
    - A seed gives the same genomes again, another seed gives others.
    - ``state`` survives msgpack, and ``restore`` continues with the same genomes.
    - An ask makes at most ``candidates`` genomes and changes neither ``best`` nor ``statistics``.
    - NaN fitness does no harm, and equal fitness does not end the search.
    - ``best`` is the best genome told, and improves, or the measures reach further.
    - With fresh seeds state and restore continue in the same way.
    - With ``competes`` all this holds for relative fitness, too.

    Args:
        optimizer_class: the class to check.
        settings: as in ``[optimizer]`` without ``kind``; defaults where omitted. An optimizer with
            the setting ``measures`` gets two unless they are named here.
        representation: what to evolve; by default a small fully-meshed network. If its genomes are
            not plain numbers, decisions near 1/4 are good instead of weights near zero.
        generations: the best fitness must have improved after this many.

    Raises:
        AssertionError: a rule is broken; the text names it.
    """
    toy = _Toy(representation or fully_meshed(3, 1))
    settings_type, given = optimizer_class.settings_type, dict(settings or {})
    if "measures" in settings_type.__struct_fields__:
        given = {"measures": ["first", "second"], **given}

    def new(seed: int = 1, *, relative: bool = False, fresh: bool = False) -> Optimizer:
        optimizer = optimizer_class(
            convert(given, settings_type, "settings"), toy.network, seed
        )
        optimizer.relative = relative
        if fresh:
            optimizer.use_fresh_seeds()
        return optimizer

    with checking(optimizer_class.__name__):
        require(
            isinstance(optimizer_class.portable, bool), ".portable must be True or False"
        )
        _check_order(new(), toy)
        _check_repeats(new, toy)
        _check_nan(new(), toy)
        _check_equal_fitness(new())
        _check_improvement(new(), toy, generations)
        with checking(", fresh"):
            _check_repeats(partial(new, fresh=True), toy)
        if optimizer_class.competes:
            with checking(", relative"):
                _check_repeats(partial(new, relative=True), toy)
            _check_relative(new(relative=True), toy, generations)


class _Toy:
    """A problem for every kind of network.

    Fitness is minus the sum of the squares of a genome's float32 numbers, or of the distances of
    decisions from 1/4 where genomes are not plain numbers. Measures are the first of these numbers.
    """

    def __init__(self, network: Representation) -> None:
        self.network = network

    def judge(
        self, genomes: Sequence[bytes], optimizer: Optimizer
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return fitness and the optimizer's measures."""
        numbers = self._numbers(genomes)
        fitness = -np.cumsum(numbers * numbers, axis=1)[:, -1]
        return fitness, numbers[:, : len(optimizer.measures)]

    def _numbers(self, genomes: Sequence[bytes]) -> np.ndarray:
        """Return (genomes, n) float64."""
        network = self.network
        text = f".ask gives genomes that {type(network).__name__}.parameters refuses"
        require_accepted(network, list(genomes), text)
        if network.genes is not None:
            rows = np.frombuffer(b"".join(genomes), "<f4").reshape(len(genomes), -1)
            return rows.astype(np.float64)
        drawn = Stream(4).uniform(-1.0, 1.0, DECISIONS * network.inputs)
        observations = drawn.reshape(DECISIONS, -1).astype(np.float32)
        actions = np.zeros((len(genomes), DECISIONS, network.outputs), np.float32)
        for row, decided in zip(network.parameters(genomes), actions, strict=True):
            state = np.zeros(network.state_size, np.float32)
            for observation, action in zip(observations, decided, strict=True):
                type(network).step(row, state, observation, action)
        return actions.reshape(len(genomes), -1).astype(np.float64) - 0.25


def _check_order(optimizer: Optimizer, toy: _Toy) -> None:
    genome, best = optimizer.best()
    text = ".best before the first tell must be without a genome"
    require(genome == b"" and not np.isfinite(best), text)
    tell = optimizer.tell
    require_raises(RuntimeError, lambda: tell(np.zeros(1)), ".tell before an ask")
    genomes = optimizer.ask()
    count, (fitness, measures) = len(genomes), toy.judge(genomes, optimizer)
    require(genomes, ".ask must give at least one genome")
    valid = all(type(genome) is bytes for genome in genomes)
    kind = type(genomes[0]).__name__
    require(valid, f".ask must give bytes, not {kind}")
    require_raises(RuntimeError, optimizer.ask, ".ask before the last one was told")
    for shape in ((count + 1,), (count, 1)):
        call = partial(tell, np.zeros(shape), measures)
        require_raises(ValueError, call, f".tell with shape {shape}")
    require(optimizer.generation == 0, ".generation counts a tell that was refused")
    if optimizer.measures:
        require_raises(ValueError, lambda: tell(fitness), ".tell without its measures")
    tell(fitness, measures)
    text = f".generation must be 1 after the first tell, not {optimizer.generation}"
    require(optimizer.generation == 1, text)
    require_raises(RuntimeError, lambda: tell(fitness, measures), ".tell a second time")


def _check_repeats(new: Callable[[int], Optimizer], toy: _Toy) -> None:
    first, again = new(1), new(1)
    history: list[Told] = []
    for generation in range(6):
        where = f"in generation {generation}"
        revived = new(1)
        revived.restore(msgspec.msgpack.decode(_packed(first.state())), history)
        require(
            revived.generation == first.generation,
            f".restore: another generation {where}",
        )
        require(
            _packed(revived.best()) == _packed(first.best()),
            f".restore: another best {where}",
        )
        if generation:
            shown = _packed((first.best(), first.statistics()))
            same = _packed((revived.best(), revived.statistics())) == shown
            require(same, f".restore: other statistics {where}")
        genomes = first.ask()
        if generation:
            same = _packed((first.best(), first.statistics())) == shown
            require(same, f".ask changes best or statistics {where}")
        most = first.candidates
        text = f".ask gives {len(genomes)} genomes; candidates is {most} {where}"
        require(most is None or len(genomes) <= most, text)
        require(again.ask() == genomes, f": the same seed asks other genomes {where}")
        require(
            revived.ask() == genomes, f": state and restore change what is asked {where}"
        )
        if generation == 0:
            require(new(2).ask() != genomes, ": another seed asks the same genomes")
        fitness, measures = toy.judge(genomes, first)
        for optimizer in (first, again, revived):
            optimizer.tell(fitness, measures)
        history.append(Told(genomes, fitness, measures))
        same = _packed(revived.state()) == _packed(first.state())
        require(
            same, f": a restored optimizer has another state after the same tell {where}"
        )


def _check_nan(optimizer: Optimizer, toy: _Toy) -> None:
    failed = len(optimizer.ask())
    optimizer.tell(
        np.full(failed, np.nan), np.full((failed, len(optimizer.measures)), np.nan)
    )
    best = float("-inf")
    for generation in range(4):
        genomes = optimizer.ask()
        fitness, measures = toy.judge(genomes, optimizer)
        if generation % 2 and len(fitness) > 1:
            fitness[::2] = np.nan
        measures[np.isnan(fitness)] = np.nan
        asked, told = list(genomes), fitness.tobytes() + measures.tobytes()
        optimizer.tell(fitness, measures)
        same = fitness.tobytes() + measures.tobytes() == told
        require(
            same, ".tell changes the fitness or measures it is given; the run needs them"
        )
        require(
            genomes == asked, ".tell changes the list that ask returned; the run needs it"
        )
        best = max(best, float(np.nanmax(fitness, initial=float("-inf"))))
        found = optimizer.best()[1]
        require(found == best, f".best after NaN fitness must be {best}, not {found}")
        statistics = optimizer.statistics()
        for name in ("best", "mean"):
            require(name in statistics, f".statistics: {name} is missing")
            require(
                np.isfinite(statistics[name]),
                f".statistics: {name} must ignore NaN fitness",
            )


def _check_equal_fitness(optimizer: Optimizer) -> None:
    """Tell the same fitness for all, as on a problem where no candidate succeeds at first."""
    for generation in range(5):
        count = len(optimizer.ask())
        text = (
            f".ask gives no genome in generation {generation} where all are equally good"
        )
        require(count > 0, text)
        optimizer.tell(np.zeros(count), np.zeros((count, len(optimizer.measures))))


def _check_improvement(optimizer: Optimizer, toy: _Toy, generations: int) -> None:
    history: list[float] = []
    reached: list[float] = []  # distances of the measures from zero
    most = float("-inf")
    for _ in range(generations):
        genomes = optimizer.ask()
        fitness, measures = toy.judge(genomes, optimizer)
        optimizer.tell(fitness, measures)
        most = max([most, *fitness.tolist()])
        genome, best = optimizer.best()
        require(best == most, f".best must be the best of all told, {most}, not {best}")
        same = toy.judge([genome], optimizer)[0][0] == best
        require(same, ".best: the genome has another fitness")
        history.append(best)
        reached.append(float(np.abs(measures).max(initial=0.0)))
    text = f": the best of {generations} generations is no better than the first: {history[0]}"
    text += "; nor do measures reach further" if optimizer.measures else ""
    require(history[-1] > history[0] or max(reached) > reached[0], text)


def _check_relative(optimizer: Optimizer, toy: _Toy, generations: int) -> None:
    """Tell each generation much worse fitness than the previous one, as if opponents improved."""
    reached: list[float] = []
    for generation in range(generations):
        genomes = optimizer.ask()
        value, measures = toy.judge(genomes, optimizer)
        fitness = value - 1e6 * generation
        optimizer.tell(fitness, measures)
        where = f"where fitness is relative, in generation {generation}"
        genome, best = optimizer.best()
        text = f".best must be the best of the last generation {where}: {fitness.max()}, not {best}"
        require(best == fitness.max(), text)
        same = genome == genomes[int(np.argmax(fitness))]
        require(same, f".best: another genome than the first of the best {where}")
        mean = optimizer.statistics()["mean"]
        text = f": the mean, {mean}, contains fitness of earlier generations {where}; "
        text += "ask for all candidates that compete again"
        require(fitness.min() - 1.0 <= mean <= fitness.max() + 1.0, text)
        reached.append(float(value.max()))
    text = f": with relative fitness generation {generations} is no better than the first"
    require(reached[-1] > reached[0], text)


def _packed(value: object) -> bytes:
    """Return bytes to compare, in which NaN equals NaN."""
    return msgspec.msgpack.encode(value)
