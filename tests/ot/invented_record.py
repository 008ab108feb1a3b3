"""Write run folders as our programs do, with a given fitness; nothing is evaluated."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np

from zswarm import experiment
from zswarm.champion.controller import Controller
from zswarm.config.sections import PartConfig, StopConfig
from zswarm.ot.cluster.events import Counted
from zswarm.ot.notes import Note
from zswarm.ot.record.history_hash import History
from zswarm.ot.record.writer import Record
from zswarm.ot.workload import Workload

EXPERIMENT = experiment.complete(experiment.load(experiment.find("stadium")), "test")


def written(
    out: Path,
    best: Sequence[float],
    *,
    seed: int = 1,
    hidden: int = 2,
    candidates: int = 3,
    finished: bool = True,
    notes: Sequence[Note] = (),
    simulator: str = "emergency-exit",
    settings: Mapping[str, Any] | None = None,
    trials: int = 1,
    optimizer: PartConfig = EXPERIMENT.optimizer,
    stop: StopConfig = EXPERIMENT.stop,
    label: str = "",
    seeds: Literal["fixed", "fresh"] = "fixed",
    held_out: float | None = None,
) -> Path:
    """Write a run with its best fitness after each generation; NaN: every candidate failed.

    Args:
        held_out: the champion's fitness in its assessment; None: it was not assessed.
    """
    representation = msgspec.structs.replace(
        EXPERIMENT.representation,
        settings={**EXPERIMENT.representation.settings, "hidden": hidden},
    )
    problem = msgspec.structs.replace(
        EXPERIMENT.problem,
        simulator=simulator,
        trials=trials,
        seeds=seeds,
        settings={**EXPERIMENT.problem.settings, **(settings or {})},
    )
    complete = msgspec.structs.replace(
        EXPERIMENT,
        seed=seed,
        label=label,
        generations=len(best) + (not finished),
        representation=representation,
        optimizer=optimizer,
        problem=problem,
        stop=stop,
    )
    genomes = [
        np.linspace(-1, 1, (hidden + 2) * (hidden + 13), dtype="<f4").tobytes()
    ] * candidates
    history = History()
    with Record.create(out, complete, "0" * 32) as record:
        for note in notes:
            record.note(note)
        for generation, value in enumerate(best):
            workload = Workload(
                genomes,
                np.arange(candidates).reshape(-1, 1),
                np.zeros(candidates, np.uint64),
                2,
            )
            workload.fitness[:], workload.metrics[:] = value, 0.0
            record.begin(generation, workload)
            record.add(Counted(np.arange(candidates), "lab-1-0123abcd", 0.01), workload)
            told = np.array([value + seed / 1e6] * candidates)
            history.add(genomes, told)
            record.finish(
                generation, genomes, told, {"best": value, "mean": value - 1.0}, {}
            )
        if len(best):
            record.champion(
                Controller(
                    simulator=simulator,
                    simulator_settings=problem.settings,
                    representation="fully-meshed",
                    representation_settings=representation.settings,
                    inputs=10,
                    outputs=2,
                    sensors=[],
                    actuators=["vx", "vy"],
                    genome=genomes[0],
                    fitness=best[-1],
                    run="run",
                )
            )
        if held_out is not None:
            found = {"low": held_out, "high": held_out, "seeds": 9, "in_search": best[-1]}
            record.set_meta("assessment", json.dumps({"mean": held_out, **found}))
        if finished:
            record.set_meta("history_hash", history.hex())
        return record.folder
