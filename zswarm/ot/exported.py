"""Which controller is exported: a run's champion, or a candidate of its record."""

from pathlib import Path

import msgspec

from zswarm.controller import CHAMPION, Controller, load_controller
from zswarm.errors import ConfigError
from zswarm.ot.chosen import candidate_of, generation_of
from zswarm.ot.reading import Run
from zswarm.protocol.codec import clean


def controller(path: Path, generation: int | None = None, candidate: int | None = None) -> Controller:
    """A controller whose names are safe to show.

    Args:
        path: a run's folder, or a champion's file.
        generation: a finished one, from 0; None: that in which the best was found.
        candidate: of it, in the order asked, from 0; None: the best. With neither it is the run's champion.

    Raises:
        ConfigError: there is no such controller, or its file or record is damaged.
    """
    found = load_controller(path)
    if generation is not None or candidate is not None:
        if not path.is_dir():
            raise ConfigError(f"{clean(str(path))}: --generation and --candidate take a run's folder, not its {CHAMPION} alone")
        found = _recorded(Run(path), found, generation, candidate)
    names = {name: clean(getattr(found, name)) for name in ("run", "simulator", "representation")}
    lists = {name: [clean(each) for each in getattr(found, name)] for name in ("sensors", "actuators")}
    return msgspec.structs.replace(found, **names, **lists)


def _recorded(run: Run, champion: Controller, generation: int | None, candidate: int | None) -> Controller:
    """Another candidate than the champion: all but the genome is theirs in common."""
    generation = generation_of(run, generation)
    candidates = {one["candidate"]: one for one in run.candidates(generation)}
    row = candidates[candidate_of(run, generation, candidates, candidate)]
    fitness = float("nan") if row["fitness"] is None else row["fitness"]
    return msgspec.structs.replace(champion, genome=row["genome"], fitness=fitness)
