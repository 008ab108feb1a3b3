"""What the commands that only look print: a table for people, or JSON."""

import time
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from zswarm import evaluate, experiment, plugins
from zswarm.draws import derive_seed
from zswarm.errors import ConfigError
from zswarm.experiment import Experiment
from zswarm.ot import record
from zswarm.ot.cluster import Found
from zswarm.ot.record import Controller
from zswarm.ot.report import print_json
from zswarm.ot.run import Parts
from zswarm.protocol.codec import clean

CHUNK = 500  # trials
UNSEEN = "unseen"  # purpose of the seeds that evolution never uses


def servers(found: list[Found], realm: str, *, as_json: bool) -> None:
    """Servers with what they have, or why they cannot be used."""
    if as_json:
        for server in found:
            print_json(
                {
                    "server": server.server,
                    **({} if server.offer is None else _offer(server.offer)),
                    "reason": server.reason,
                }
            )
        return
    if not found:
        _print(f"no server in realm {realm}; start zswarm-ss on the machines, or name one with --connect tcp/HOST:7467")
        return
    table = _table("server", "slots", "free", "runs", "simulators", "zswarm", "matches")
    for server in found:
        if server.offer is None:
            _row(table, server.server, "", "", "", "", "", f"no: {server.reason}")
        else:
            offer = server.offer
            matches = f"no: {offer.mismatch}" if offer.mismatch else "yes"
            simulators = ", ".join(offer.simulators)
            _row(table, server.server, offer.capacity, offer.free, offer.leases, simulators, offer.program, matches)
    Console().print(table)


def _offer(offer: Any) -> dict[str, Any]:
    values: dict[str, Any] = msgspec.to_builtins(offer)
    return {key: value for key, value in values.items() if key not in ("type", "v", "server")}


def everything(folder: Path, *, as_json: bool) -> None:
    """Runs, examples and parts."""
    runs = record.runs(folder)
    parts = {kind: plugins.names(kind) for kind in ("simulator", "representation", "optimizer")}
    examples = sorted(path.stem for path in experiment.examples_folder().glob("*.toml"))
    if as_json:
        print_json({"runs": runs, "examples": examples, **{f"{kind}s": names for kind, names in parts.items()}})
        return
    for title, names in (("examples", examples), *((f"{kind}s", names) for kind, names in parts.items())):
        _print(f"{title:16}{', '.join(names)}")
    if not runs:
        _print(f"{'runs':16}none in {folder}")
        return
    table = _table("run", "generations", "best", "last at", "history")
    for row in runs:
        if "error" in row:
            _row(table, row["run"], "", "", "", row["error"])
            continue
        at = time.strftime("%Y-%m-%d %H:%M", time.localtime(row["finished_at"])) if row["finished_at"] else ""
        best = "" if row["best"] is None else f"{row['best']:.6g}"
        history = row["history_hash"][:12] if row["history_hash"] else "not finished"
        _row(table, row["run"], row["generations"], best, at, history)
    Console().print(table)


def check(complete: Experiment, parts: Parts, *, as_json: bool) -> None:
    """What an experiment amounts to."""
    simulator, network = parts.simulator, parts.representation
    values = {
        "experiment": complete.name,
        "simulator": complete.problem.simulator,
        "agents": len(simulator.owners),
        "inputs": simulator.inputs,
        "outputs": simulator.outputs,
        "metrics": list(simulator.metrics),
        "trials": complete.problem.trials,
        "representation": complete.representation.kind,
        "genome_bytes": network.genome_bytes,
        "optimizer": complete.optimizer.kind,
        "portable": parts.optimizer.portable,
        "generations": complete.generations,
        "candidates_first_generation": len(parts.optimizer.ask()),
    }
    if as_json:
        print_json(values)
        return
    for key, value in values.items():
        _print(f"{key.replace('_', ' '):28}{', '.join(value) if isinstance(value, list) else value}")
    _print("the experiment is fine")


def evaluated(controller: Controller, trials: int, seed: int, *, as_json: bool) -> None:
    """A champion on unseen seeds.

    Raises:
        ConfigError: it does not fit what it names, or its simulator raises.
    """
    simulator, network = evaluate.build(
        controller.simulator,
        controller.simulator_settings,
        controller.representation,
        controller.representation_settings,
    )
    seeds = np.array([derive_seed(seed, UNSEEN, trial) for trial in range(trials)], np.uint64)
    participants = np.zeros((trials, simulator.participants), np.int64)
    parts = []
    for begin in range(0, trials, CHUNK):  # Ctrl-C is heard between two
        part = slice(begin, begin + CHUNK)
        try:
            parts.append(evaluate.evaluate(simulator, network, [controller.genome], participants[part], seeds[part]))
        except ValueError as error:
            raise ConfigError(f"the champion does not fit its network: {error}") from None
        if parts[-1].error:
            raise ConfigError(f"the simulator raised: {parts[-1].error}")
    fitness = np.concatenate([outcomes.fitness[:, 0] for outcomes in parts])
    metrics = np.concatenate([outcomes.metrics for outcomes in parts])
    low, median, high = np.percentile(fitness, (25, 50, 75))
    values = {
        "trials": trials, "mean": float(fitness.mean()), "q25": float(low), "median": float(median), "q75": float(high),
        **{name: float(metrics[:, i].mean()) for i, name in enumerate(simulator.metrics)},
    }  # fmt: skip
    if as_json:
        print_json(values)
        return
    _print(
        f"{controller.simulator}, champion of {clean(controller.run)} (fitness {controller.fitness:.6g}), {trials} unseen trials"
    )
    _print(f"{'fitness':16}mean {values['mean']:.6g}, quartiles {low:.6g} / {median:.6g} / {high:.6g}")
    for name in simulator.metrics:
        _print(f"{name:16}mean {values[name]:.6g}")


def _table(*columns: str) -> Table:
    table = Table(box=box.SIMPLE, pad_edge=False)
    for column in columns:
        table.add_column(column, overflow="fold")
    return table


def _row(table: Table, *cells: object) -> None:
    table.add_row(*(Text(str(cell)) for cell in cells))  # as Text: a cell's brackets are no markup


def _print(text: object) -> None:
    Console().print(Text(str(text)), soft_wrap=True)
