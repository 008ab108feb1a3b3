"""Select a recorded candidate by its generation and its number, or the champion."""

import math
from pathlib import Path

import msgspec

from zswarm.champion.controller import CHAMPION, Controller, load_controller
from zswarm.errors import ConfigError
from zswarm.ot.record.history_hash import digest
from zswarm.ot.record.reader import NAMES, Row, Run, cleaned
from zswarm.system.text import clean


def generation_of(run: Run, generation: int | None) -> int:
    """Return a finished generation, counted from 0; by default the one that found the best.

    Raises:
        ConfigError: the run has no such generation.
    """
    count = run.generations()
    if not count:
        raise ConfigError(f"{run.shown}: no generation is finished")
    if generation is None:
        best = run.best()
        found = [int(row["generation"]) for row in run.history() if row["best"] == best]
        return count - 1 if run.relative or not found else found[0]
    if not 0 <= generation < count:
        raise ConfigError(
            f"{run.shown}: no generation {generation + 1}; {available('generation', count, 1)}"
        )
    return generation


def place_of(
    run: Run, generation: int | None, candidate: int | None
) -> tuple[int, int | None]:
    """Return generation and candidate, from 0; without both those of the champion.

    The champion is the candidate that the assessment chose, where there was one; it may be another
    one than the best in search. A candidate of None is the best of the generation.

    Raises:
        ConfigError: the run has no such generation, or its champion's file is damaged.
    """
    if generation is None and candidate is None and (champion := run.champion()):
        rows = run.rows(
            "SELECT generation, candidate FROM candidates WHERE digest = ? "
            "AND genome IS NOT NULL ORDER BY generation, candidate LIMIT 1",
            tuple[int, int],
            digest(champion.genome),
        )
        if rows:
            return rows[0]
    return generation_of(run, generation), candidate


def candidate_of(
    run: Run, generation: int, candidates: dict[int, Row], candidate: int | None
) -> int:
    """Return the number of a candidate, counted from 0 as asked; by default of the best.

    Args:
        candidates: rows of ``Run.candidates`` by their number.

    Raises:
        ConfigError: the generation has no such candidate.
    """

    def rank(number: int) -> tuple[float, int]:
        fitness = candidates[number]["fitness"]
        return -math.inf if fitness is None else fitness, -number

    if candidate is None and candidates:
        return max(candidates, key=rank)
    if candidate not in candidates:
        what = f"no candidate {candidate} in generation {generation + 1}"
        raise ConfigError(
            f"{run.shown}: {what}; {available('candidate', len(candidates))}"
        )
    return candidate


def genome_of(
    run: Run, generation: int, candidates: dict[int, Row], candidate: int
) -> bytes:
    """Return the genome of a candidate.

    Args:
        candidates: rows of ``Run.candidates`` by their number.

    Raises:
        ConfigError: it is not kept.
    """
    genome: bytes | None = candidates[candidate]["genome"]
    if genome is None:
        kept = [number for number, row in candidates.items() if row["genome"] is not None]
        numbers = ", ".join(map(str, kept[:5]))
        raise ConfigError(
            f"{run.shown}: the genome of candidate {candidate} in generation {generation + 1} was "
            f"not kept ([record] genomes); of this generation are kept {numbers or 'none'}"
        )
    return genome


def available(what: str, count: int, first: int = 0) -> str:
    """Return, in words, the valid numbers of things that are counted from ``first``."""
    if count < 2:
        return f"it has {what} {first} only" if count else f"it has no {what}s"
    return f"it has {what}s {first} to {first + count - 1}"


def controller(
    path: Path, generation: int | None = None, candidate: int | None = None
) -> Controller:
    """Return a recorded controller, its names safe to show.

    Args:
        path: a run's folder, or a champion's file.
        generation: a finished one, from 0; None: the one that found the best.
        candidate: from 0, in the order asked; None: the best. Without both: the run's champion.

    Raises:
        ConfigError: there is no such controller, or its file or record is damaged.
    """
    found = load_controller(path)
    if generation is not None or candidate is not None:
        if not path.is_dir():
            raise ConfigError(
                f"{clean(str(path))}: --generation and --candidate take a run's folder, "
                f"not its {CHAMPION} alone"
            )
        run = Run(path)
        generation = generation_of(run, generation)
        rows = {row["candidate"]: row for row in run.candidates(generation)}
        number = candidate_of(run, generation, rows, candidate)
        row, genome = rows[number], genome_of(run, generation, rows, number)
        fitness = math.nan if row["fitness"] is None else row["fitness"]
        found = msgspec.structs.replace(found, genome=genome, fitness=fitness)
    return cleaned(found, *NAMES)
