"""The champion's part of a report: its results on held-out seeds, a film, and its weights."""

from typing import Any, NamedTuple

import numpy as np

from zswarm import evaluate
from zswarm.champion.controller import Controller
from zswarm.config import ranges
from zswarm.errors import ConfigError, EvaluationError
from zswarm.nets.fully_meshed import FullyMeshed
from zswarm.nets.representation import Representation
from zswarm.ot.replay import held_out, trace
from zswarm.ot.replay import svg as film
from zswarm.sims import randomized
from zswarm.sims.simulator import Simulator
from zswarm.system.text import clean

MAX_CELLS = 10_000  # of a picture of weights
SEED = 0  # of the held-out trials, as in ``zswarm-ot evaluate``


class Weights(NamedTuple):
    """A fully-meshed network as a table."""

    rows: list[str]
    columns: list[str]
    cells: list[list[tuple[float, float]]]  # value, and its share of the greatest


def sections(champion: Controller, trials: int) -> dict[str, Any]:
    """Return ``played`` (or ``not_played``), ``film`` (or ``no_film``) and ``weights``."""
    found = _played(champion, trials) if trials else {}
    try:
        simulator, network = evaluate.build(
            champion.simulator,
            champion.simulator_settings,
            champion.representation,
            champion.representation_settings,
        )
    except (ConfigError, MemoryError):
        return found
    return (
        found
        | _film(champion, simulator, network)
        | {"weights": _weights(champion, network)}
    )


def number(value: float | None) -> str:
    """Format a number; None and NaN become ``none``."""
    return "none" if value is None or not np.isfinite(value) else f"{value:.6g}"


def _played(champion: Controller, trials: int) -> dict[str, Any]:
    """Return the champion's results, or why it could not be played."""
    try:
        return {"played": held_out.play(champion, trials, SEED)}
    except (ConfigError, EvaluationError, MemoryError) as error:
        return {"not_played": clean(str(error)) or "there is not enough memory"}


def _film(
    champion: Controller, simulator: Simulator, network: Representation
) -> dict[str, str]:
    """Film the first held-out trial, or return why that failed; empty if nothing is drawn."""
    seed = held_out.trial_seed(SEED, 0)
    genomes = [champion.genome] * simulator.participants
    try:
        seen = trace.record(simulator, network, genomes, seed, film.MOST_TURNS)
    except (ValueError, EvaluationError, MemoryError) as error:
        return {"no_film": clean(f"{type(error).__name__}: {error}")}
    if not seen.frames or seen.error:
        why = seen.error or seen.no_picture
        return {"no_film": why} if why else {}
    title = "the first of the held-out trials"
    for path, value in randomized.values(champion.simulator_settings, seed).items():
        title += f", {clean(ranges.name(path))} {clean(ranges.shown(value))}"
    panel = film.Panel(title, seen.frames)
    return {"film": film.svg([panel]).replace(f' xmlns="{film.NAMESPACE}"', "")}


def _weights(champion: Controller, network: Representation) -> Weights | None:
    """Return the weights of a fully-meshed network that fits its genome."""
    if (
        not isinstance(network, FullyMeshed)
        or len(champion.genome) != network.genome_bytes
    ):
        return None
    table = network.tables([champion.genome])[0].astype(np.float64)
    if table.size > MAX_CELLS or not np.isfinite(table).all():
        return None
    neurons = trace.named((), "hidden", network.neurons - champion.outputs)
    neurons += trace.named(champion.actuators, "output", champion.outputs)
    sources = [*trace.named(champion.sensors, "input", champion.inputs), *neurons, "bias"]
    greatest = float(np.abs(table).max()) or 1.0
    cells = [[(value, abs(value) / greatest) for value in row] for row in table.tolist()]
    return Weights(neurons, sources, cells)
