"""List the targets and decide whether the results of the scripts meet them."""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import tables
from tables import FLAGSHIP, FREVO, Found, figure, share

Results = dict[str, Found]  # by script
BESIDE_C = (
    (FLAGSHIP, 8),
    (FLAGSHIP, 32),
    (FLAGSHIP, 128),
    ("emergency-exit stadium", 72),
    ("emergency-exit random", 10),
)


NEAR = 1.1  # a target missed by a smaller factor is reported in percent
NOISY = ("minisim", "emergency-exit", "arena-foraging", "foraging-physical")


class Aim(NamedTuple):
    """A target.

    Attributes:
        key: of the reason in ``missed.toml`` if the target is missed.
        value: measured value; None if not measured.
        at_least: True for a minimum, False for a maximum.
    """

    key: str
    what: str
    wanted: float
    at_least: bool
    value: float | None
    written: Callable[[float], str] = figure

    @property
    def held(self) -> bool:
        """Return whether the measured value meets the target."""
        return self.value is not None and (
            self.value >= self.wanted if self.at_least else self.value <= self.wanted
        )

    @property
    def row(self) -> list[str]:
        """Return a row of the table: quantity, target, measured value, verdict."""
        wanted = (
            f"{'at least' if self.at_least else 'at most'} {self.written(self.wanted)}"
        )
        if self.value is None:
            return [self.what, wanted, "", "not measured"]
        if self.held:
            verdict = "met"
        elif not self.value:  # of no run, as in a quick form
            verdict = "missed"
        else:
            by = self.wanted / self.value if self.at_least else self.value / self.wanted
            verdict = f"missed by a factor of {by:.2f}"
            if by < NEAR:
                share = abs(self.value - self.wanted) / self.wanted
                verdict = f"missed by {100 * share:.1f} %"
        return [self.what, wanted, self.written(self.value), verdict]


def aims(results: Results) -> Iterator[Aim]:
    """Yield all targets in order."""
    yield from of_dispatch(results.get("dispatch"))
    yield from of_scale(results.get("scale"))
    yield from of_startup(results.get("startup"))
    yield from of_commands(results.get("commands"))
    yield from of_questions(results.get("questions"))
    yield from of_kernels(results.get("kernels"))
    yield from of_runs(results.get("runs"))
    yield from of_populations(results.get("populations"))
    yield from of_scaling(results.get("scaling"))
    yield from of_noise(results.get("noise"))


def of_dispatch(found: Found | None) -> Iterator[Aim]:
    """Yield the overhead compared with other tools, and the efficiency."""

    def value(peer: str, work: str, slots: int, of: int = 400) -> float | None:
        row = tables.main_way(found, peer, work, slots, of) if found else None
        return row and row.get("us", row.get("efficiency"))

    ours = value("zswarm", "noop", 4)
    yield Aim("noop", "no-op, 400 candidates, 4 slots: us per candidate", 5, False, ours)
    small = value("zswarm", "noop", 2, 50)
    what = "no-op, 50 candidates, 2 slots: us per candidate"
    yield Aim("noop-50", what, 15, False, small)
    for peer, wanted in (
        ("Ray", 25),
        ("Dask distributed", 40),
        ("MQTT (stock)", 12),
        ("ProcessPoolExecutor", 4),
    ):
        theirs = value(peer, "noop", 4)
        yield Aim(
            f"noop-{peer}",
            f"400 candidates, 4 slots: times faster than {peer}",
            wanted,
            True,
            theirs / ours if theirs and ours else None,
        )
    loop = value("no dispatch", "sleep", 1)
    for slots, wanted in ((2, 0.95), (4, 0.95), (8, 0.95), (16, 0.92)):
        used = value("zswarm", "sleep", slots)
        what = f"sleep 5 ms, 400 candidates, {slots} slots: efficiency / that of a loop"
        relative = used / loop if used and loop else None
        yield Aim(f"sleep-{slots}", what, wanted, True, relative, share)
    cores = found["machine"]["cores"] if found else 2
    what = "efficiency, 5 ms of a core, 400 candidates, a slot per core"
    yield Aim("cpu", what, 0.95, True, value("zswarm", "cpu", cores), share)


def of_scale(found: Found | None) -> Iterator[Aim]:
    """Yield the targets with many simulated servers."""
    rows = found["rows"] if found else []
    slots = {
        (row["slots"], row["routed"]): row for row in rows if row.get("trial_s") == 1.0
    }
    servers = {(row["servers"], row["routed"]): row for row in rows if "ready_s" in row}
    for routed, key, by in ((False, "", ""), (True, "-routed", ", with a router")):
        used = slots.get((4096, routed), {}).get("efficiency")
        what = f"efficiency, 4,096 simulated slots, trials of 1 s{by}"
        yield Aim(f"scale{key}", what, 0.9, True, used, share)
        costs = [row["optimizer_us"] for (_, by_), row in slots.items() if by_ == routed]
        few = "1,024" if routed else "64"
        what = (
            f"{few} to 4,096 slots, trials of 1 s{by}: us of the optimizer per evaluation"
        )
        yield Aim(f"scale-cpu{key}", what, 120, False, max(costs, default=None))
        for count, wanted in ((256, 1.0), (1024, 2.0)):
            ready = servers.get((count, routed), {}).get("ready_s")
            what = f"discovery and handshake, {count:,} servers{by}: s"
            aim = f"discovery-{count}{key}"
            yield Aim(aim, what, wanted, False, ready, "{:.2f}".format)
    sent = [max(row["messages"].values()) for row in rows if row.get("servers") == 256]
    yield Aim(
        "messages",
        "256 servers: messages in each direction per server, without renewals",
        2,
        False,
        next(iter(sent), None),
    )


def of_startup(found: Found | None) -> Iterator[Aim]:
    """Yield the time to the first result, and the memory of a slot."""
    rows = found["rows"] if found else []
    times = {(row["of"], row.get("how")): row.get("s") for row in rows}
    slot = [
        tables.mib(row["own_mb"])
        for row in rows
        if (row["what"], row["of"]) == ("memory", "slot")
    ]
    for key, how, what, wanted in (
        ("first", "warm", "first result, warm cache", 0.7),
        ("cold", "cold", "first result, empty cache", 5.0),
    ):
        value = times.get(("zswarm-ot run", how))
        yield Aim(key, f"{what}: s", wanted, False, value, "{:.2f}".format)
    yield Aim(
        "memory", "private memory of a slot: MiB", 40, False, next(iter(slot), None)
    )


def of_commands(found: Found | None) -> Iterator[Aim]:
    """Yield how long commands take from return to prompt."""
    times = {row["of"]: row["s"] for row in found["rows"]} if found else {}
    for key, of, wanted in (
        ("one", "a run of one generation", 1.5),
        ("version", "--version", 0.12),
        ("help", "--help", 0.12),
        ("completion", "completion of a word", 0.12),
        ("list", "list of 200 runs", 0.3),
    ):
        yield Aim(key, f"{of}: s", wanted, False, times.get(of), "{:.2f}".format)


def of_questions(found: Found | None) -> Iterator[Aim]:
    """Yield the time of a question to controllers at the optimizer."""
    times = {row["of"]: row["us"] for row in found["rows"]} if found else {}
    what = "controllers at the optimizer: us of a question and its answer"
    value = times.get("a question for each turn")
    yield Aim("questions", what, 150, False, value)


def of_kernels(found: Found | None) -> Iterator[Aim]:
    """Yield the speed of kernels compared with C, pymunk and VMAS, per core."""
    rows = [row for row in found["rows"] if "agent_steps_per_s" in row] if found else []
    rate = {
        (row["kernel"], row["variant"], row["agents"]): row["agent_steps_per_s"]
        for row in rows
    }
    for kernel, agents in BESIDE_C:
        theirs, ours = (
            rate.get((kernel, "C", agents)),
            rate.get((kernel, "numba", agents)),
        )
        value = theirs / ours if theirs and ours else None
        what = f"{kernel}, {agents} agents: time relative to tuned C"
        yield Aim(f"C-{kernel}-{agents}", what, 1.25, False, value, "{:.2f}".format)
    for variant, wanted in (("pymunk", 50), ("vmas flocking", 30)):
        theirs, ours = rate.get((FLAGSHIP, variant, 8)), rate.get((FLAGSHIP, "numba", 8))
        name = "VMAS flocking" if variant.startswith("vmas") else variant
        yield Aim(
            variant,
            f"{FLAGSHIP}, 8 agents: speed relative to {name}",
            wanted,
            True,
            ours / theirs if theirs and ours else None,
        )


def of_runs(found: Found | None) -> Iterator[Aim]:
    """Yield the speed of whole runs compared with FREVO."""
    by_field = {row["field"]: row for row in found["rows"]} if found else {}
    for field, times, whole in (("stadium", 20, 8), ("random", 10, 6)):
        row = by_field.get(field, {})
        theirs = f"{FREVO[field]:,.0f} simulations/s"
        what = (
            f"EmergencyExit, NNGA 50 x 200, {field}: speed relative to FREVO's {theirs}"
        )
        for key, measured, wanted, how in (
            ("run", "per_s", times, ""),
            ("run-whole", "whole_per_s", whole, ", with the start of the slots"),
        ):
            value = row[measured] / FREVO[field] if row else None
            yield Aim(f"{key}-{field}", what + how, wanted, True, value)


def of_populations(found: Found | None) -> Iterator[Aim]:
    """Yield the optimizer's time and memory in large populations."""
    rows = {row["population"]: row for row in found["rows"]} if found else {}
    for population, wanted in ((8_000, 0.1), (100_000, 2.0)):
        value = rows.get(population, {}).get("generation_s")
        what = f"NNGA, population {population:,}: s per generation besides the trials"
        yield Aim(f"nnga-{population}", what, wanted, False, value, "{:.3f}".format)
    what = "NNGA, population 100,000: memory of the optimizer, MB"
    value = rows.get(100_000, {}).get("mb")
    yield Aim("nnga-memory", what, 1_000, False, value)


def of_scaling(found: Found | None) -> Iterator[Aim]:
    """Yield how well short evaluations use many servers, the start included."""
    rows = {(row["work"], row["servers"]): row for row in found["rows"]} if found else {}
    value = rows.get(("sleep", 16), {}).get("efficiency")
    what = "efficiency, 16 servers, evaluations of 20 ms, with the start"
    yield Aim("scaling", what, 0.9, True, value, share)


def of_noise(found: Found | None) -> Iterator[Aim]:
    """Yield what reported fitness, champions, fresh seeds and racing are worth."""
    rows = {(row["task"], row["mode"]): row for row in found["rows"]} if found else {}
    gaps = [abs(row["assessed_gap"]) for row in rows.values()]
    what = "reported and held-out fitness of champions: the largest median difference"
    yield Aim("noise-gap", what, 0.05, False, max(gaps, default=None), share)
    for task in NOISY:
        for mode in ("fixed", "fresh"):
            value = rows.get((task, mode), {}).get("assessed_beats_search")
            what = f"{task}, {mode} seeds: A12 of champions with and without assessment"
            yield Aim(f"noise-assessed-{task}-{mode}", what, 0.6, True, value, share)
    for task in NOISY:
        value = rows.get((task, "fresh"), {}).get("assessed_beats_fixed")
        what = f"{task}: A12 of champions with fresh seeds and with fixed ones"
        yield Aim(f"noise-fresh-{task}", what, 0.5, True, value, share)
    for task in NOISY:
        choice = rows.get((task, "fixed"), {}).get("choice", {})
        what = f"{task}: share of the simulations that racing saves"
        yield Aim(f"noise-saved-{task}", what, 0.3, True, choice.get("saved"), share)
        right = choice["right_raced"] / choice["right_equal"] if choice else None
        what = f"{task}: racing's right choices, relative to those of all trials"
        yield Aim(f"noise-right-{task}", what, 1.0, True, right, share)
