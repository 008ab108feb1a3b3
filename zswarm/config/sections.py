"""The tables of an experiment file: keys, types, limits, defaults and meaning (docs/experiment.md).

``zswarm-ot init`` and the tables of the document show the descriptions.
"""

import itertools
import json
import math
from collections.abc import Sequence
from typing import Annotated, Any, Literal, NamedTuple

import msgspec
from msgspec import Meta

from zswarm.config.meta import about, above, within
from zswarm.protocol.messages import MIN_MEMORY_MB, Megabytes
from zswarm.system.text import clean

Positive = Annotated[int, Meta(ge=1, le=1_000_000_000)]
KeptGenomes = Literal["all", "best"] | Positive
MAX_RUNS = 10_000  # of a study
ABSOLUTE = "absolute"  # the default ranking
KindName = Annotated[
    str, about("name of one (`zswarm-ot list`); its settings follow in the same table")
]


class ProblemConfig(
    msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True
):
    """``[problem]``: how a candidate is judged, by the sum or mean of its trials."""

    simulator: Annotated[str, about("name of a simulator (`zswarm-ot list`)")]
    trials: Annotated[int, within(1, 100_000, "trials that judge each candidate")] = 1
    seeds: Annotated[
        Literal["fixed", "fresh"],
        about(
            "seeds of the trials: the same for the whole run, or new in each generation; "
            "survivors are then re-evaluated ([noise.md](noise.md#fresh-seeds))"
        ),
    ] = "fixed"
    settings: Annotated[
        dict[str, Any], about("settings of the simulator: `[problem.settings]`, below")
    ] = {}


class PartKind(msgspec.Struct, frozen=True, kw_only=True):
    """``[representation]`` and ``[optimizer]`` without the settings of their kind."""

    kind: KindName


class RankingKind(msgspec.Struct, frozen=True, kw_only=True):
    """``[ranking]`` without the settings of its kind."""

    kind: KindName = ABSOLUTE


class PartConfig(msgspec.Struct, frozen=True, kw_only=True):
    """``[representation]``, ``[optimizer]`` or ``[ranking]``."""

    kind: str
    settings: dict[str, Any]


class ClusterConfig(
    msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True
):
    """``[cluster]``: who computes. Nothing in it changes the result."""

    realm: Annotated[
        str, Meta(description="servers of the same realm are used", extra={"type": "id"})
    ] = "default"
    servers: Annotated[
        Literal["auto", "local"] | Positive,
        about(
            '"auto": this machine\'s slots and every server found; "local": this '
            "machine's slots only; a number: wait for as many servers, 10 s at most, and use no "
            "slots of this machine"
        ),
    ] = "auto"
    connect: Annotated[
        list[str],
        about(
            "endpoints to dial: servers that multicast does not reach, or a router; "
            'such as "tcp/192.168.1.5:7467". Protocols: `tcp`, `tls`, `ws`, `udp`, '
            "`unixsock-stream`"
        ),
    ] = []
    multicast: Annotated[bool, about("find servers by multicast")] = True
    through_router: Annotated[
        bool,
        about(
            "reach the servers only through a router: one of `connect`, or one that "
            "multicast finds ([network.md](network.md)); does not affect this machine's slots"
        ),
    ] = False
    local_slots: Annotated[
        int,
        within(
            0, 65_535, 'slots of this machine under "auto" and "local"; 0: one per core'
        ),
    ] = 0
    require: Annotated[
        list[str],
        about(
            "conditions that the labels of servers must meet, including this machine's "
            'slots, such as `["gpu=yes", "room=b12|b13", "name!=lab-3", "cores>=8"]`; others are '
            "not used ([mixed.md](mixed.md))"
        ),
    ] = []
    rank: Annotated[
        list[str],
        about(
            "which servers are preferred, most important first: a condition "
            '(`"gpu=yes"`), or a label whose higher number comes first (`"cores"`; `"-cores"`: '
            "the lower) ([mixed.md](mixed.md))"
        ),
    ] = []
    max_slots: Annotated[
        int,
        within(
            0,
            1_000_000_000,
            "slots that a run holds at the same time, including this machine's; the best by "
            "`rank`. It never holds more than it has trials at once. 0: no other limit",
        ),
    ] = 0
    trial_timeout_s: Annotated[
        float, above(0, 1e9, "seconds by the wall clock after which a trial is a fault")
    ] = 300.0
    trial_memory_mb: Annotated[
        Megabytes,
        Meta(
            description="memory of a slot's process in MB, including about 100 for itself; a trial "
            "that needs more is a fault, and servers that have less per slot are not used. 0: what "
            "each server gives",
            extra={"type": f"int, 0 or {MIN_MEMORY_MB} to 2^40"},
        ),
    ] = 0
    on_fault: Annotated[
        Literal["pause", "quarantine"],
        about(
            "what to do when a trial failed three times by a crash, a timeout or a "
            'lack of memory: "pause" stops the run (exit code 1; `resume` tries again); '
            '"quarantine" counts the trial as NaN, continues, and marks the result as faulted'
        ),
    ] = "pause"
    verify: Annotated[
        float,
        within(
            0,
            1,
            "share of the trials that a second server evaluates as well; see "
            '[protocol.md](protocol.md), "Verification"',
        ),
    ] = 0.0
    controller: Annotated[
        Literal["server", "optimizer"],
        about(
            'where candidates decide: "server": servers receive genomes and play whole '
            'trials; "optimizer": this program decides, and servers ask it in every turn of a '
            "trial, which takes some hundred times as long "
            "([protocol.md](protocol.md#the-controller-at-the-optimizer))"
        ),
    ] = "server"
    messages: Annotated[
        Literal["turn", "agent"],
        about(
            'what servers ask with `controller = "optimizer"`: "turn": one question '
            'for all agents that act; "agent": one for each'
        ),
    ] = "turn"

    def __post_init__(self) -> None:
        if self.messages != "turn" and self.controller != "optimizer":
            raise ValueError(
                f'messages: expected "turn" unless controller is "optimizer", not "{self.messages}"'
            )
        memory = self.trial_memory_mb
        if 0 < memory < MIN_MEMORY_MB:
            raise ValueError(
                f"trial_memory_mb: expected 0 or at least {MIN_MEMORY_MB}, not {memory}"
            )


class AssessmentConfig(
    msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True
):
    """``[assessment]``: which candidate of the whole run is the champion.

    Search is as without, except for ``racing``.
    """

    budget: Annotated[
        Literal["auto"] | Annotated[float, Meta(ge=0, le=10)],
        about(
            "simulations after the last generation, as a share of those of the run "
            '([noise.md](noise.md)). "auto": 0.1 if trials differ; 0: none, the champion is the '
            "best in search"
        ),
    ] = "auto"
    candidates: Annotated[
        int,
        within(1, 1000, "the best distinct candidates of the whole run that are raced"),
    ] = 20
    track: Annotated[
        int,
        within(
            0,
            1_000_000_000,
            "the best of each k-th generation plays 100 held-out seeds after the last one, for "
            "the learning curve; 0: none",
        ),
    ] = 0
    racing: Annotated[
        bool,
        about(
            "stop trials of candidates that will hardly survive their generation "
            "([noise.md](noise.md#racing-inside-a-generation)); this changes the history"
        ),
    ] = False


class RecordConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """``[record]``: what is kept of a run. Nothing in it changes the result."""

    genomes: Annotated[
        KeptGenomes,
        about(
            "whose genomes are kept of a finished generation "
            '([record.md](record.md#fewer-genomes)): "all"; "best": that of its best candidate; a '
            "number N: all of every N-th generation, that of the best candidate of the others"
        ),
    ] = "all"


class StopConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """``[stop]``: when a run ends before its last generation, judged after each generation.

    0, and the fitness "none": no such limit.
    """

    evaluations: Annotated[
        int,
        within(
            0,
            1_000_000_000,
            "evaluations that a run may use: it ends where another generation as large as the "
            "last would exceed them",
        ),
    ] = 0
    simulations: Annotated[
        int, within(0, 1_000_000_000_000, "likewise, in simulations: trials, or games")
    ] = 0
    fitness: Annotated[
        float | Literal["none"],
        about("end once a candidate has this fitness, as the mean of its trials"),
    ] = "none"
    stagnation: Annotated[
        int,
        within(0, 1_000_000_000, "end after this many generations without a better one"),
    ] = 0
    seconds: Annotated[
        float,
        within(
            0,
            1e9,
            "end after this time of computing; such a run does not repeat on other machines",
        ),
    ] = 0.0


class BudgetConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """``study.budget``: what each run may use. Give one of them."""

    evaluations: Annotated[int, within(0, 1_000_000_000, "evaluations of each run")] = 0
    simulations: Annotated[
        int, within(0, 1_000_000_000_000, "simulations of each run")
    ] = 0

    def __post_init__(self) -> None:
        if self.evaluations and self.simulations:
            raise ValueError("expected evaluations or simulations, not both")


class StudyConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """``[study]``: several runs of one file. It takes no part in the history of any."""

    repeat: Annotated[
        int,
        within(
            1, MAX_RUNS, "runs of each setting, with the seeds `seed`, `seed` + 1, ..."
        ),
    ] = 1
    at_once: Annotated[
        int, within(0, 100, "runs at the same time; 0: as many as keep the slots busy")
    ] = 0
    budget: Annotated[
        BudgetConfig,
        about(
            "what each run may use, in place of `generations`: "
            "`{ evaluations = 20000 }` or `{ simulations = 200000 }`"
        ),
    ] = BudgetConfig()
    variants: Annotated[
        dict[str, dict[str, Any]],
        about(
            "named settings: `[study.variants.NAME]`, each with the paths and values, or "
            "the tables, that it changes; with a grid, every combination"
        ),
    ] = {}
    grid: Annotated[
        dict[str, list[Any]],
        about(
            'paths and their values, such as `"optimizer.population" = [50, 100]`: '
            "every combination is a setting. A value may be a whole table, and have a `label`"
        ),
    ] = {}
    listed: Annotated[
        list[dict[str, Any]],
        about(
            "instead of a grid, the settings one by one: `[[study.list]]`, each with "
            "the paths and values that it changes"
        ),
    ] = msgspec.field(default_factory=list, name="list")

    def settings(self) -> list["StudySetting"]:
        """Return the settings in order; the last key of the grid varies fastest."""
        if self.listed:
            return [StudySetting(dict(each), "") for each in self.listed]
        axes = [
            [({path: value}, _label(value)) for value in values]
            for path, values in self.grid.items()
        ]
        if self.variants:
            named = [(dict(each), name) for name, each in self.variants.items()]
            axes.insert(0, named)
        return [_joined(row) for row in itertools.product(*axes)]

    def asks_for_runs(self) -> bool:
        """Return whether this asks for more than the experiment's own run."""
        varies = any(changes for changes, _ in self.settings())
        return self.runs() > 1 or varies or self.budget != BudgetConfig()

    def count(self) -> int:
        """Return the number of settings."""
        grid = math.prod(map(len, self.grid.values()))
        return len(self.listed) or grid * max(1, len(self.variants))

    def runs(self) -> int:
        """Return the number of runs."""
        return self.repeat * self.count()


class StudySetting(NamedTuple):
    """A setting of a study."""

    changes: dict[str, Any]  # by path
    label: str  # chosen by the user, or ""


def shown(value: Any) -> str:
    """Return a value in a few words: of a table the kind."""
    if isinstance(value, dict) and isinstance(value.get("kind"), str):
        return clean(value["kind"])
    return clean(value if isinstance(value, str) else json.dumps(value, default=str))


def _label(value: Any) -> str:
    """Return the label of a grid's value that is a table, or ""."""
    found = value.get("label") if isinstance(value, dict) else None
    return found if isinstance(found, str) else ""


def _joined(row: Sequence[tuple[dict[str, Any], str]]) -> StudySetting:
    """Return the setting of a combination; it has a label if any of its parts has one."""
    changes: dict[str, Any] = {}
    labels = []
    for changed, label in row:
        for path, value in changed.items():
            table = isinstance(value, dict) and "label" in value
            changes[path] = (
                {key: item for key, item in value.items() if key != "label"}
                if table
                else value
            )
        words = (
            f"{path.rpartition('.')[2]} {shown(value)}" for path, value in changed.items()
        )
        labels.append(label or ", ".join(words))
    return StudySetting(
        changes, ", ".join(labels) if any(each for _, each in row) else ""
    )
