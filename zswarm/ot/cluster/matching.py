"""What a run asks of servers, and which of them it uses."""

import secrets
from typing import TYPE_CHECKING, NamedTuple

import msgspec

from zswarm.config.sections import ClusterConfig
from zswarm.experiment import Experiment
from zswarm.ot.cluster.machines import Known
from zswarm.plugins.version_hash import version_hash, versions
from zswarm.protocol import labels
from zswarm.protocol.labels import Preference, Term
from zswarm.protocol.messages import MAX_SLOTS, Offer, Part, Requirements, Reserve

if TYPE_CHECKING:
    from zswarm.sims.simulator import Simulator  # which loads the compiler


class Choice(NamedTuple):
    """The servers that ``[cluster]`` chooses."""

    require: tuple[Term, ...] = ()
    rank: tuple[Preference, ...] = ()
    max_slots: int = 0  # of all servers together; 0: no limit

    def mismatch(self, offer: Offer) -> str:
        """Return why a server cannot be used; "" if it can."""
        return offer.mismatch or labels.unmet(self.require, offer.labels)

    def place(self, offer: Offer) -> tuple[float, ...]:
        """Return a server's rank among others: the lowest comes first."""
        return labels.place(self.rank, offer.labels)


class RunProgram(NamedTuple):
    """How servers know one of the programs of a run."""

    epoch: int  # how often the run was resumed
    secret: bytes  # of the run


class Terms(msgspec.Struct, frozen=True, kw_only=True):
    """What a run asks of servers, and how it uses them."""

    requirements: Requirements
    reserve: Reserve  # with the number of slots wanted on every server
    secret: bytes = b""  # of the run; b"": its leases can be taken over by others
    choice: Choice = Choice()
    participants: int = 1  # of a trial
    metrics: int = 0  # of a trial
    quarantine: bool = False  # count a trial that faults again and again as NaN
    verify: float = 0.0  # share of the trials that a second server evaluates, too
    probe: bytes = b""  # digest of the probe's outcomes; b"": the first server's counts
    known: Known = Known()  # what earlier programs of the run found out
    # Whether a trial may be with two servers, of which the first outcome is counted.
    second_starts: bool = True


def choice(options: ClusterConfig) -> Choice:
    """Return the servers that ``[cluster]`` chooses."""
    require = labels.requirements(options.require, "cluster.require")
    return Choice(
        require, labels.preferences(options.rank, "cluster.rank"), options.max_slots
    )


def requirements(complete: Experiment, options: ClusterConfig) -> Requirements:
    """Return the query whether a server can evaluate an experiment."""
    problem, representation = complete.problem, complete.representation.kind
    return Requirements(
        simulator=problem.simulator,
        representation=representation,
        version_hash=version_hash(problem.simulator, representation),
        settings=problem.settings,
        versions=versions(problem.simulator, representation),
        trial_memory_mb=options.trial_memory_mb,
    )


def terms(
    complete: Experiment,
    options: ClusterConfig,
    simulator: "Simulator",
    program: RunProgram,
    *,
    slots: int,
    probe: bytes,
    known: Known = Known(),  # noqa: B008  frozen
) -> Terms:
    """Return the terms on which servers evaluate an experiment."""
    problem, representation = complete.problem, complete.representation
    asked = requirements(complete, options)
    reserve = Reserve(
        nonce=secrets.token_bytes(16),
        epoch=program.epoch,
        slots=min(slots, MAX_SLOTS),
        simulator=Part(problem.simulator, problem.settings),
        representation=Part(representation.kind, representation.settings),
        version_hash=asked.version_hash,
        asks=options.messages if options.controller == "optimizer" else "",
        trial_timeout_s=options.trial_timeout_s,
        trial_memory_mb=options.trial_memory_mb,
    )
    return Terms(
        requirements=asked,
        reserve=reserve,
        secret=program.secret,
        choice=choice(options),
        participants=simulator.participants,
        metrics=len(simulator.metrics),
        quarantine=options.on_fault == "quarantine",
        verify=options.verify if simulator.repeatable else 0.0,
        probe=probe,
        known=known,
        # Of outcomes that differ, the first one is that of a short trial more often; robots may be
        # real. And a controller at the optimizer would be asked twice.
        second_starts=simulator.repeatable and not reserve.asks,
    )
