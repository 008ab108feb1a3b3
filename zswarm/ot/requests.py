"""What an optimizer asks of a server, as messages: made from the dispatch's ``Ask`` and the run it is for."""

from typing import NamedTuple

from zswarm.ot.dispatch import Ask
from zswarm.ot.matching import Choice
from zswarm.ot.workload import Workload
from zswarm.protocol.messages import Asks, Cancel, Evaluate, Part, Release, Renew, Request, Requirements, Reserve


class Wanted(NamedTuple):
    """What a run asks of servers."""

    requirements: Requirements
    choice: Choice
    simulator: Part
    representation: Part
    participants: int
    metrics: int
    trial_timeout_s: float
    trial_memory_mb: int
    slots: int
    quarantine: bool
    verify: float
    probe: bytes
    asks: Asks = ""  # of controllers that stay at the optimizer


class Who(NamedTuple):
    """Who asks."""

    realm: str
    user: str
    run: str
    epoch: int
    nonce: bytes


def request(ask: Ask, who: Who, wanted: Wanted, workload: Workload | None) -> Request:
    """The message of a question; an evaluate is of the workload."""
    match ask.verb:
        case "offer":
            return wanted.requirements
        case "reserve":
            return Reserve(
                nonce=who.nonce,
                epoch=who.epoch,
                slots=ask.slots,
                simulator=wanted.simulator,
                representation=wanted.representation,
                version_hash=wanted.requirements.version_hash,
                trial_timeout_s=wanted.trial_timeout_s,
                trial_memory_mb=wanted.trial_memory_mb,
                asks=wanted.asks,
            )
        case "renew":
            return Renew(lease=ask.lease, known_ready=ask.known_ready)
        case "cancel":
            return Cancel(lease=ask.lease, batches=list(ask.batches))
        case "release":
            return Release(lease=ask.lease)
    assert workload is not None and ask.trials is not None  # noqa: PT018, S101  an evaluate has both
    genomes, participants, seeds = workload.batch(ask.trials)
    return Evaluate(
        lease=ask.lease,
        batch=ask.batch,
        genomes=[b""] * len(genomes) if wanted.asks else genomes,
        participants=participants.astype("<u4").tobytes(),
        seeds=seeds.astype("<u8").tobytes(),
    )
