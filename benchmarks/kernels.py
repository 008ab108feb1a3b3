"""Measure whole simulations on one core, compared with other ways to compute the same.

Agent-steps per second of ``arena`` (aggregation; a robot per m2; 8 -> 6 + 2 neurons of tanh, 152
genes; 500 steps), compiled by numba, in plain Python, in C (``kernels/arena.c``, -O3 -march=native)
and in numpy, 64 candidates at once; pymunk's physics and segment queries with the same network in
numpy; VMAS's flocking, 512 environments at once, whose model is another. EmergencyExit likewise in
C (``kernels/emergency_exit.c``), eight trials side by side and one by one; of zswarm also the other
tasks and Minisim. Each measurement is a process of its own, of CPU time of one thread; the ways
take turns, and medians count. What is quoted was measured elsewhere.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import machine
from tables import ARGOS, FLAGSHIP, FREVO

HERE = Path(__file__).resolve().parent
PEERS = HERE.parent / "build" / "peers" / "bin" / "python"
STEPS = 500
AGENTS = (8, 32, 128)
NETWORK = {"hidden": 6, "iterations": 1, "activation": "tanh"}
BATCH = 64  # candidates at once in numpy
ROUNDS_OF_EXIT = 50  # of emergency-exit
LEAST_S = 0.3  # of CPU time in a measurement
ROUNDS = 5

Row = dict[str, Any]


class NotThereError(Exception):
    """A variant cannot be measured here."""


def timed(
    work: Callable[[], object],
    simulations: float,
    agent_steps: int,
    least_s: float = LEAST_S,
) -> Row:
    """Repeat a call for a while; return a row with its simulations and agent-steps per second."""
    work()
    calls, begin = 0, time.thread_time()
    while (elapsed := time.thread_time() - begin) < least_s:
        work()
        calls += 1
    return {
        "agent_steps_per_s": agent_steps * calls / elapsed,
        "seconds_per_simulation": elapsed / calls / simulations,
    }


# ---- zswarm, and C -----------------------------------------------------------------------------


def problem(kernel: str, agents: int) -> tuple[Any, Any]:
    """Build a simulator and a network."""
    from zswarm.evaluate import build

    if kernel.startswith("arena-"):
        settings = {
            "task": kernel.removeprefix("arena-"),
            "robots": agents,
            "side": agents**0.5,
            "steps": STEPS,
        }
        return build("arena", settings, "fully-meshed", NETWORK)
    if kernel == "minisim":
        return build("minisim", {}, "fully-meshed", {})
    return build(
        "emergency-exit",
        {"field": kernel.split()[1], "steps": ROUNDS_OF_EXIT},
        "fully-meshed",
        {},
    )


def trials(kernel: str, agents: int, count: int) -> tuple[Any, ...]:
    """Return arguments of ``evaluate.evaluate``: candidates, in ten rooms where these are drawn."""
    import numpy as np

    from zswarm.kernels.random import Stream

    simulator, network = problem(kernel, agents)
    rooms = 10 if kernel == "emergency-exit random" and count > 1 else 1
    genomes = network.random(count, Stream(1))
    seeds = range(count) if rooms == 1 else [*range(rooms)] * count
    return (
        simulator,
        network,
        genomes,
        np.arange(count).repeat(rooms)[:, None],
        np.array(seeds, np.uint64),
    )


def candidates(kernel: str, agents: int) -> int:
    """Return the number of candidates in one call."""
    return BATCH if kernel.startswith("emergency-exit") else max(256 // agents, 4)


def steps_of(simulator: Any, fitness: Any, metrics: Any) -> int:
    """Return the agent-steps of trials; emergency-exit counts its rounds with all agents."""
    agents = len(simulator.owners)
    if "rounds" in simulator.metrics:
        return int(metrics[:, simulator.metrics.index("rounds")].sum()) * agents
    return simulator.settings.steps * agents * len(fitness)


def with_numba(kernel: str, agents: int) -> Row:
    from zswarm.evaluate import evaluate

    prepared = trials(kernel, agents, candidates(kernel, agents))
    fitness, metrics, _ = evaluate(*prepared)
    return timed(
        lambda: evaluate(*prepared), len(fitness), steps_of(prepared[0], fitness, metrics)
    )


def in_plain_python(kernel: str, agents: int) -> Row:
    from zswarm.evaluate import evaluate

    if kernel.startswith("arena-") and agents > AGENTS[0]:
        raise NotThereError(f"measured at {AGENTS[0]} agents only: it takes minutes")
    prepared = trials(kernel, agents, 1)
    begin = time.thread_time()
    fitness, metrics, _ = evaluate(*prepared)
    elapsed = time.thread_time() - begin
    return {
        "agent_steps_per_s": steps_of(prepared[0], fitness, metrics) / elapsed,
        "seconds_per_simulation": elapsed,
    }


def with_c(kernel: str, agents: int, *, side_by_side: bool = True) -> Row:
    import in_c

    if in_c.compiler() is None:
        raise NotThereError("no C compiler")
    arena = kernel.startswith("arena-")
    in_that = (
        in_c.Arena(in_c.FAST)
        if arena
        else in_c.EmergencyExit(in_c.FAST, side_by_side=side_by_side)
    )
    prepared = trials(kernel, agents, candidates(kernel, agents))
    fitness, metrics = in_that.evaluate(*prepared)
    return timed(
        lambda: in_that.evaluate(*prepared),
        len(fitness),
        steps_of(prepared[0], fitness, metrics),
    )


def with_c_one_by_one(kernel: str, agents: int) -> Row:
    return with_c(kernel, agents, side_by_side=False)


def with_numpy(kernel: str, agents: int) -> Row:
    import in_numpy

    arena = in_numpy.Arena(*trials(kernel, agents, BATCH))
    return timed(arena.play, BATCH, BATCH * agents * STEPS)


# ---- others ------------------------------------------------------------------------------------


def with_pymunk(_: str, agents: int) -> Row:
    """Simulate in pymunk: its solver pushes bodies, eight segment queries a step, numpy network."""
    import math

    import numpy as np
    import pymunk

    side, sight, radius, random = agents**0.5, 1.2, 0.1, np.random.default_rng(1)
    ways = [
        (math.cos(angle), math.sin(angle))
        for angle in (ray * math.pi / 4 for ray in range(8))
    ]
    weights, biases = (
        random.uniform(-2, 2, (8, 18)).astype(np.float32),
        random.uniform(-2, 2, 8).astype(np.float32),
    )
    everything, steps = pymunk.ShapeFilter(), 50

    def simulate() -> None:
        space, bodies = pymunk.Space(), []
        corners = [(0, 0), (side, 0), (side, side), (0, side), (0, 0)]
        space.add(
            *(
                pymunk.Segment(space.static_body, corners[i], corners[i + 1], 0.01)
                for i in range(4)
            )
        )
        for _ in range(agents):
            body = pymunk.Body(1, 1)
            body.position, body.angle = (
                tuple(random.uniform(radius, side - radius, 2)),
                random.uniform(0, 2 * np.pi),
            )
            space.add(body, pymunk.Circle(body, radius))
            bodies.append(body)
        seen = np.zeros((agents, 18), np.float32)
        for _ in range(steps):
            places = np.array([tuple(body.position) for body in bodies])
            offsets = places - places[:, None]
            near = (offsets**2).sum(axis=2) < sight**2
            means = (
                (offsets * near[:, :, None]).sum(axis=1)
                / np.maximum(near.sum(axis=1) - 1, 1)[:, None]
                / sight
            )
            headings = []
            for number, body in enumerate(bodies):
                (x, y), (mean_x, mean_y) = places[number].tolist(), means[number].tolist()
                cosine, sine = math.cos(body.angle), math.sin(body.angle)
                headings.append((cosine, sine))
                row = []
                for u, v in ways:
                    way_x, way_y = cosine * u - sine * v, sine * u + cosine * v
                    begin = x + way_x * (radius + 0.001), y + way_y * (radius + 0.001)
                    hit = space.segment_query_first(
                        begin, (x + way_x * sight, y + way_y * sight), 0, everything
                    )
                    row.append(1 - hit.alpha if hit else 0.0)
                seen[number, :10] = (
                    *row,
                    mean_x * cosine + mean_y * sine,
                    mean_y * cosine - mean_x * sine,
                )
            seen[:, 10:] = np.tanh(seen @ weights.T + biases)
            for body, (cosine, sine), (left, right) in zip(
                bodies, headings, seen[:, 16:].tolist(), strict=True
            ):
                left, right = 2 * min(max(left, 0), 1) - 1, 2 * min(max(right, 0), 1) - 1
                body.velocity = (
                    0.15 * (left + right) * cosine,
                    0.15 * (left + right) * sine,
                )
                body.angular_velocity = 1.5 * (right - left)
            space.step(0.1)

    return timed(simulate, steps / STEPS, steps * agents)


def with_vmas(_: str, agents: int) -> Row:
    """Simulate VMAS's flocking: robots with 12 rays, 512 environments, a small network in torch."""
    try:
        import torch
        import vmas
    except ImportError as error:
        raise NotThereError(f"{error}; `make bench` installs it") from error
    if agents > AGENTS[0]:
        raise NotThereError(f"measured at {AGENTS[0]} agents only")
    torch.set_num_threads(1)
    environments = vmas.make_env(
        scenario="flocking", num_envs=512, device="cpu", n_agents=agents, seed=1
    )
    seen = environments.reset()
    network = torch.nn.Sequential(
        torch.nn.Linear(seen[0].shape[-1], 8),
        torch.nn.Tanh(),
        torch.nn.Linear(8, 2),
        torch.nn.Tanh(),
    )

    def step() -> None:
        nonlocal seen
        with torch.no_grad():
            seen = environments.step([network(one) for one in seen])[0]

    return timed(step, 512 / STEPS, 512 * agents, 1.0)


WAYS: dict[str, Callable[[str, int], Row]] = {
    "numba": with_numba,
    "C": with_c,
    "C, one by one": with_c_one_by_one,
    "numpy batch": with_numpy,
    "pymunk": with_pymunk,
    "plain": in_plain_python,
    "vmas flocking": with_vmas,
}
OTHERS = {  # and how many agents they have
    "arena-dispersion": 8,
    "arena-foraging": 8,
    "arena-consensus": 8,
    "emergency-exit stadium": 72,
    "emergency-exit random": 10,
    "minisim": 8,
}


def quoted() -> list[Row]:
    """Return figures that others published, for one core; in FREVO all agents act in all rounds."""
    rows: list[Row] = [
        {
            "kernel": FLAGSHIP,
            "variant": "ARGoS diffusion",
            "agents": 8,
            "agent_steps_per_s": ARGOS,
            "quoted": True,
        }
    ]
    for field, per_s in FREVO.items():
        kernel = f"emergency-exit {field}"
        rate = {
            "agent_steps_per_s": per_s / 2 * OTHERS[kernel] * ROUNDS_OF_EXIT,
            "seconds_per_simulation": 2 / per_s,
        }
        rows.append(
            {
                "kernel": kernel,
                "variant": "FREVO",
                "agents": OTHERS[kernel],
                **rate,
                "quoted": True,
            }
        )
    return rows


def wanted(*, quick: bool) -> list[tuple[str, str, int]]:
    """Yield kernel, variant and number of agents of each measurement."""
    exits = [
        (kernel, agents)
        for kernel, agents in OTHERS.items()
        if kernel.startswith("emergency-exit")
    ]
    fast = [(FLAGSHIP, agents) for agents in AGENTS] + exits
    beside_c = [
        (kernel, variant, agents) for kernel, agents in fast for variant in ("numba", "C")
    ]
    if quick:
        return [each for each in beside_c if each[2] != AGENTS[1]]
    others = [
        (FLAGSHIP, variant, agents)
        for agents in AGENTS
        for variant in ("numpy batch", "pymunk")
    ]
    others += [(FLAGSHIP, variant, AGENTS[0]) for variant in ("plain", "vmas flocking")]
    others += [(kernel, "C, one by one", agents) for kernel, agents in exits]
    ours = [
        (kernel, variant, agents)
        for kernel, agents in OTHERS.items()
        for variant in ("numba", "plain")
    ]
    return list(dict.fromkeys([*beside_c, *others, *ours]))


def measured(kernel: str, variant: str, agents: int) -> Row:
    """Measure once in a separate process."""
    python = PEERS if variant == "vmas flocking" and PEERS.exists() else sys.executable
    environment = os.environ | {
        "ZSWARM_PLAIN": "" if variant == "numba" else "1",
        "OPENBLAS_NUM_THREADS": "1",
    }
    command = [python, HERE / "kernels.py", "--one", kernel, variant, str(agents)]
    done = subprocess.run(
        command, env=environment, capture_output=True, text=True, check=False
    )
    if done.returncode:
        return {
            "missing": (done.stderr.strip().splitlines() or ["it ended without a word"])[
                -1
            ]
        }
    row: Row = json.loads(done.stdout.splitlines()[-1])
    return row


def one(kernel: str, variant: str, agents: int) -> None:
    """Run one measurement in this process."""
    try:
        row = WAYS[variant](kernel, agents)
    except NotThereError as error:
        row = {"missing": str(error)}
    print(json.dumps(row))


def main() -> None:
    """Measure, print and write ``kernels.json``."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--quick",
        action="store_true",
        help="zswarm and C only, and one round unless said: whether it works",
    )
    parser.add_argument("--rounds", type=int, help=f"[default] {ROUNDS}")
    parser.add_argument("--folder", type=Path, help="of the results")
    parser.add_argument(
        "--one", nargs=3, metavar=("KERNEL", "VARIANT", "AGENTS"), help=argparse.SUPPRESS
    )
    arguments = parser.parse_args()
    if arguments.one:
        one(arguments.one[0], arguments.one[1], int(arguments.one[2]))
        return
    machine.warn_if_busy()
    found: dict[tuple[str, str, int], list[Row]] = {}
    for number in range(arguments.rounds or (1 if arguments.quick else ROUNDS)):
        for way in wanted(quick=arguments.quick):
            fast = way[1] in ("numba", "C", "C, one by one", "numpy batch")
            if number == 0 or (fast and "missing" not in found[way][0]):
                found.setdefault(way, []).append(measured(*way))
    rows = []
    for (kernel, variant, agents), some in found.items():
        row: Row = {"kernel": kernel, "variant": variant, "agents": agents}
        if "missing" in some[0]:
            row["missing"] = some[0]["missing"]
        else:
            row |= {
                key: statistics.median(each[key] for each in some if key in each)
                for key in some[0]
            }
        rows.append(row)
        said = (
            row.get("missing") or f"{row['agent_steps_per_s'] / 1e3:,.0f} k agent-steps/s"
        )
        print(f"{kernel:24} {variant:14} {agents:4} agents  {said}", flush=True)
    rows += [] if arguments.quick else quoted()
    machine.write(
        "kernels", rows, ["pymunk", "vmas", "torch", "gcc"], folder=arguments.folder
    )


if __name__ == "__main__":
    main()
