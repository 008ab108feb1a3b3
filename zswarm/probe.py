"""The probe: the trials by which machines are compared."""

import hashlib
import time
from typing import NamedTuple

from zswarm.evaluate import TrialOutcomes, play_probe
from zswarm.kernels.jit import compile_all
from zswarm.nets.representation import Representation
from zswarm.protocol.messages import PROBE_DIGEST, PROBE_TRIALS
from zswarm.sims.simulator import Simulator

# Seconds of trials that a process plays before it reports them, except for the first one: other
# slots of its server may play the rest.
ALONE_S = 0.25


class Probe(NamedTuple):
    """The result of trials that every machine plays."""

    digest: bytes  # of each trial's outcomes, PROBE_DIGEST bytes; empty if it is not repeatable
    trial_s: float  # time of one of the trials


def probe(
    simulator: Simulator,
    representation: Representation,
    most: int = PROBE_TRIALS,
    *,
    first: int = 0,
    budget_s: float = ALONE_S,
    in_turns: bool = False,
) -> Probe:
    """Play trials by which machines are compared; compile or load what they need before.

    They are four random genomes on two seeds. Of a simulator that is not repeatable, one trial is
    played.

    Args:
        most: trials to play.
        first: of these.
        budget_s: seconds; what would take longer is left out, except for the first trial.
    """
    if not in_turns:
        compile_all()  # what this takes is not the time of a trial
    parts: list[TrialOutcomes] = []
    spent_s, trial_s, played, begin = 0.0, 0.0, 0, time.perf_counter()
    while played < most:
        # At first one at a time: the first one may load something.
        count = 1 if played < 2 else most - played
        if played:
            count = int(min(count, (budget_s - spent_s) / trial_s))
        if count < 1:
            break
        some = slice(first + played, first + played + count)
        parts.append(play_probe(simulator, representation, some, in_turns=in_turns))
        before_s, spent_s = spent_s, time.perf_counter() - begin
        trial_s = (spent_s - before_s) / count
        played += count
        if not simulator.repeatable:
            return Probe(b"", trial_s)
    return Probe(b"".join(map(_digests, parts)), trial_s)


def _digests(outcomes: TrialOutcomes) -> bytes:
    """Return a digest for each trial, one after the other."""
    rows = zip(outcomes.fitness, outcomes.metrics, strict=True)
    return b"".join(
        hashlib.blake2b(
            fitness.astype("<f8").tobytes() + metrics.astype("<f8").tobytes(),
            digest_size=PROBE_DIGEST,
        ).digest()
        for fitness, metrics in rows
    )
