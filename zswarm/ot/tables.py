"""What the commands that only look print: a table for people, or JSON."""

import textwrap
import time
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from zswarm import __version__, evaluate, experiment, plugins
from zswarm.draws import derive_seed
from zswarm.errors import ConfigError
from zswarm.experiment import Experiment
from zswarm.ot import listing
from zswarm.ot.controller import Controller
from zswarm.ot.discovery import Found, Survey
from zswarm.ot.report import print_json
from zswarm.ot.run import Parts
from zswarm.protocol.codec import clean

CHUNK = 500  # trials
NAME_WIDTH = 40  # of a server: with the other columns it fits into 80
NUMBERS = ("slots", "free", "runs", "generations", "best")  # columns
UNSEEN = "unseen"  # purpose of the seeds that evolution never uses


def servers(survey: Survey, realm: str, *, through_router: bool, experiment_name: str = "", as_json: bool) -> None:
    """Servers with what they have, and why one is of no use; or why there are none.

    Args:
        experiment_name: the experiment that the servers were asked about; "": about none.
    """
    for server in survey.servers if as_json else []:
        offer = {} if server.offer is None else _offer(server.offer)
        print_json({"server": server.server, **offer, "address": server.address, "reason": server.reason})
    if survey.servers and not as_json:
        _server_table(survey.servers, realm, through_router=through_router, experiment_name=experiment_name)
    if not survey.servers:
        _print(f"no server found in realm {realm}", stderr=as_json)
        for finding in survey.findings:
            _paragraph(f"- {finding}", stderr=as_json)
    elif survey.elsewhere:
        others = ", ".join(f"{name} ({count})" for name, count in survey.elsewhere.items())
        _paragraph(f"servers of other realms, seen with --realm: {others}", stderr=as_json)


def _server_table(found: list[Found], realm: str, *, through_router: bool, experiment_name: str) -> None:
    offers = [server.offer for server in found if server.offer is not None]
    slots, free = sum(offer.capacity for offer in offers), sum(offer.free for offer in offers)
    _print(f"realm {realm}: {len(found)} server{'s' if len(found) != 1 else ''}, {slots} slots, {free} free\n")
    columns = ("server", "slots", "free", "runs", "zswarm", *(["matches"] if experiment_name else []))
    table = _table(*columns, box=None, padding=(0, 2, 0, 0))
    reasons: dict[str, list[str]] = {}
    simulators: dict[str, list[str]] = {}
    for server in found:
        address = server.address or ("through the router" if through_router else "")
        name = "\n".join(textwrap.wrap(server.server, NAME_WIDTH) + [f"  {address}"] * bool(address))
        if server.offer is None:
            _row(table, name, "", "", "", "", *(["no"] if experiment_name else []))
            reasons.setdefault(server.reason, []).append(server.server)
            continue
        offer = server.offer
        matches = ["no" if offer.mismatch else "yes"] if experiment_name else []
        _row(table, name, offer.capacity, offer.free, offer.leases, offer.program, *matches)
        simulators.setdefault(", ".join(offer.simulators), []).append(server.server)
        if offer.mismatch:
            versions = f" (that is zswarm {offer.program}, this is {__version__})" if offer.program != __version__ else ""
            reasons.setdefault(offer.mismatch + versions, []).append(server.server)
    Console().print(table)
    _print("")
    of_experiment = f" for {experiment_name}" if experiment_name else ""
    for reason, names in reasons.items():
        _paragraph(f"not used{of_experiment}: {', '.join(names)}: {reason}")
    if not experiment_name:
        for names_of_simulators, names in simulators.items():
            where = "" if len(simulators) == 1 else f" on {', '.join(names)}"
            _paragraph(f"simulators{where}: {names_of_simulators}")


def _offer(offer: Any) -> dict[str, Any]:
    values: dict[str, Any] = msgspec.to_builtins(offer)
    return {key: value for key, value in values.items() if key not in ("type", "v", "server")}


def everything(folder: Path, *, as_json: bool) -> None:
    """Runs, examples and parts."""
    runs = listing.runs(folder)
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


def _table(*columns: str, box: box.Box | None = box.SIMPLE, padding: tuple[int, int, int, int] = (0, 1, 0, 1)) -> Table:
    table = Table(box=box, padding=padding, pad_edge=False)
    for column in columns:
        table.add_column(column, overflow="fold", justify="right" if column in NUMBERS else "left")
    return table


def _row(table: Table, *cells: object) -> None:
    table.add_row(*(Text(str(cell)) for cell in cells))  # as Text: a cell's brackets are no markup


def _print(text: object, *, stderr: bool = False) -> None:
    Console(stderr=stderr).print(Text(str(text)), soft_wrap=True)


def _paragraph(text: str, *, stderr: bool = False) -> None:
    """Lines of the terminal's width, the second and later ones indented; names are not broken."""
    lines = textwrap.wrap(
        text, Console(stderr=stderr).width, subsequent_indent="  ", break_on_hyphens=False, break_long_words=False
    )
    _print("\n".join(lines), stderr=stderr)
