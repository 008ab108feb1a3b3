"""Measure all designs on the same optimizations; ``findings.py`` interprets the numbers.

Each row is one optimization: which part of the measurements it belongs to, design, world, servers,
and what it took.
"""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import machine
import numpy as np

from paper import files, world
from paper.broker import Broker
from paper.local import Local
from paper.names import FILES, LOCAL, NODELAY, PAPER_STEP_S, STOCK, ZENOH
from paper.over_zenoh import WAYS, Servers
from paper.world import Optimized, Size, World
from zswarm.ot.build import build as build_parts
from zswarm.ot.problem import Problem
from zswarm.ot.workload import Workload

Row = dict[str, Any]
# On so many servers; what else there is to say.
Optimize = Callable[[World, Size, int], tuple[Optimized, Row]]

ONE = Size(1, 3)  # a generation, the smallest that NNGA takes


class Plan(NamedTuple):
    """The amount of work to measure."""

    rounds: int = 3  # of the four designs
    figure_4: Size = Size()  # the paper's
    designs_steps: int = 50
    crowd_steps: int = 20  # of minisim beside them
    grid_agents: tuple[int, ...] = (1, 8)
    grid_steps: tuple[int, ...] = (10, 20, 30)
    grid_step_s: float = PAPER_STEP_S
    message_agents: tuple[int, ...] = (1, 2, 4, 8, 16)
    # The difference is of messages alone; the slow broker has the first two.
    message_steps: tuple[int, ...] = (10, 60, 210)
    servers: tuple[int, ...] = (1, 2, 4, 8, 16)
    scaling_steps: tuple[int, ...] = (10, 20)
    scaling_step_s: float = 0.05
    crowded: Size = Size(trials=8)  # enough simulations in a generation for 16 servers
    crowded_step_s: float = 0.02
    evolve: Size = Size(200, 50)  # Table I's


QUICK = Plan(
    rounds=1,
    figure_4=ONE,
    designs_steps=10,
    crowd_steps=10,
    grid_agents=(1, 2),
    grid_steps=(10, 12),
    grid_step_s=0.002,
    message_agents=(1, 8),
    message_steps=(10, 14, 30),
    servers=(1, 2),
    scaling_steps=(10,),
    scaling_step_s=0.002,
    crowded=Size(2, 4, 2),
    crowded_step_s=0.002,
    evolve=Size(5, 50),
)


def measure(plan: Plan, say: Callable[[str], None]) -> Row:
    """Return ``rows``, and ``missing``: what could not be measured and why."""
    rows: list[Row] = []
    missing: dict[str, str] = {}
    say("no transport")
    rows += _parts(LOCAL, _locally, plan, servers=(1,))
    rows.append({"part": "evolve", "design": LOCAL, "s": evolve_s(plan.evolve)})
    for build, name in FILES.items():
        if why := files.missing(build):
            missing[name] = why
            continue
        say(name)
        with files.workspace(build) as opened:
            rows += _designs(
                name, _by_files(opened), plan, rounds=plan.rounds if build == "cc" else 1
            )
            if build == "cc":
                rows += _grid(name, _by_files(opened), plan, "emergency-exit")
    for name in (STOCK, NODELAY):
        say(name)
        with Broker(nodelay=name == NODELAY) as broker:
            rows += _parts(name, _by_broker(broker), plan, servers=plan.servers)
    with Servers() as servers:
        for way, name in ZENOH.items():
            say(name)
            servers.grow(1)
            optimize = _over_zenoh(servers, way)
            optimize(World(), ONE, 1)  # whatever is compiled or loaded for the first
            rows += _designs(name, optimize, plan, rounds=plan.rounds)
            rows += _messages(name, optimize, plan)
        for way in WAYS:
            say(f"{ZENOH[way]}, more servers")
            rows += _scaling(
                ZENOH[way],
                _over_zenoh(servers, way),
                plan,
                plan.servers,
                paced=way == "blob",
            )
    return {"rows": rows, "missing": missing}


def evolve_s(size: Size) -> float:
    """Return t_evo: NNGA's time between generations of nets with 60 numbers."""
    chance = np.random.default_rng(1)

    def judge(_problem: Problem, workload: Workload) -> None:
        workload.fitness[:, 0] = chance.normal(size=len(workload.seeds))

    return world.optimize(world.load(World(), size), judge).seconds / size.generations


# ---- parts -------------------------------------------------------------------------------------


def _parts(
    name: str, optimize: Optimize, plan: Plan, *, servers: tuple[int, ...]
) -> list[Row]:
    """Return the parts by which designs that simulate minisim are measured."""
    optimize(World(), ONE, 1)
    rows = _designs(name, optimize, plan, rounds=plan.rounds) + _messages(
        name, optimize, plan
    )
    if name != LOCAL:
        rows += _grid(name, optimize, plan, "minisim") + _scaling(
            name, optimize, plan, servers, paced=True
        )
    return rows


def _designs(name: str, optimize: Optimize, plan: Plan, *, rounds: int) -> list[Row]:
    """Run the same optimization by each design, on emergency exit and minisim."""
    rows = [
        _row("designs", name, optimize, World(steps=plan.designs_steps), plan.figure_4, 1)
        for _ in range(rounds)
    ]
    if not name.startswith("files"):
        rows += [
            _row(
                "designs",
                name,
                optimize,
                World("minisim", steps=plan.crowd_steps),
                plan.figure_4,
                1,
            )
            for _ in range(rounds)
        ]
    return rows


def _messages(name: str, optimize: Optimize, plan: Plan) -> list[Row]:
    """Run short and longer simulations as fast as possible."""
    return [
        _row("messages", name, optimize, World("minisim", agents, steps), ONE, 1)
        for agents in plan.message_agents
        for steps in (plan.message_steps[:2] if name == STOCK else plan.message_steps)
    ]


def _grid(name: str, optimize: Optimize, plan: Plan, kind: str) -> list[Row]:
    """Simulate in real time, for the coefficients of equations 9 and 10."""
    return [
        _row("grid", name, optimize, World(kind, agents, steps, plan.grid_step_s), ONE, 1)
        for agents in plan.grid_agents
        for steps in plan.grid_steps
    ]


def _scaling(
    name: str, optimize: Optimize, plan: Plan, servers: tuple[int, ...], *, paced: bool
) -> list[Row]:
    """Run Figure 4 in real time, and again with enough simulations for all servers."""
    rows = []
    for count in servers:
        if paced:
            rows += [
                _row(
                    "scaling",
                    name,
                    optimize,
                    World("minisim", 8, steps, plan.scaling_step_s),
                    plan.figure_4,
                    count,
                )
                for steps in plan.scaling_steps
            ]
        rows.append(
            _row(
                "crowded",
                name,
                optimize,
                World("minisim", 8, 10, plan.crowded_step_s),
                plan.crowded,
                count,
            )
        )
    return rows


def _row(
    part: str, name: str, optimize: Optimize, on: World, size: Size, servers: int
) -> Row:
    found, more = optimize(on, size, servers)
    about = {
        "part": part,
        "design": name,
        **on._asdict(),
        **size._asdict(),
        "servers": servers,
    }
    return (
        about
        | {"s": found.seconds, "simulations": found.simulations, "history": found.history}
        | more
    )


# ---- designs -----------------------------------------------------------------------------------


def _locally(on: World, size: Size, _servers: int) -> tuple[Optimized, Row]:
    local = Local()
    found = world.optimize(world.load(on, size), local.play)
    return found, {"turns": local.turns, "decisions": local.decisions}


def _by_files(opened: files.Files) -> Optimize:
    def optimize(on: World, size: Size, _servers: int) -> tuple[Optimized, Row]:
        opened.spent.clear()
        found = world.optimize(world.load(on, size), opened.play)
        means = [sum(each) / len(each) for each in zip(*opened.spent, strict=True)]
        return found, {
            "first_compile_s": opened.spent[0].compile_s,
            **dict(zip(files.Spent._fields, means, strict=True)),
        }

    return optimize


def _by_broker(broker: Broker) -> Optimize:
    def optimize(on: World, size: Size, servers: int) -> tuple[Optimized, Row]:
        loaded = world.load(on, size)
        broker.grow(servers, build_parts(loaded).problem)
        broker.messages = 0
        found = world.optimize(loaded, broker.play)
        return found, {"messages": broker.messages}

    return optimize


def _over_zenoh(opened: Servers, way: str) -> Optimize:
    def optimize(on: World, size: Size, servers: int) -> tuple[Optimized, Row]:
        opened.grow(servers)
        return opened.optimize(size, on, servers, way), {}

    return optimize


def results(plan: Plan, folder: Path) -> Path:
    """Measure and write ``folder/results.json``."""
    machine.warn_if_busy()
    begin = time.monotonic()

    def say(what: str) -> None:
        print(f"{time.monotonic() - begin:4.0f} s  {what}", flush=True)

    with world.installed():
        found = measure(plan, say)
    seconds = round(time.monotonic() - begin)
    return machine.write(
        "results",
        found["rows"],
        ("paho-mqtt", "mosquitto", "gcc"),
        folder=folder,
        missing=found["missing"],
        seconds=seconds,
    )
