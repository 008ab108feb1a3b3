"""The probe: the trials by which machines are compared."""

import hashlib
import time
from typing import NamedTuple

from zswarm.evaluate import TrialOutcomes, play_probe, warm_up
from zswarm.kernels.jit import compile_all
from zswarm.nets.representation import Representation
from zswarm.protocol.messages import PROBE_DIGEST, PROBE_TRIALS
from zswarm.sims.simulator import Simulator

PROBE_S = 10.0  # seconds that a probe may take, except for its first trial


class Probe(NamedTuple):
    """The result of the trials that every machine plays."""

    digest: bytes  # of each trial's outcomes, PROBE_DIGEST bytes; empty if it is not repeatable
    trial_s: float  # time of one of the trials


def probe(
    simulator: Simulator,
    representation: Representation,
    most: int = PROBE_TRIALS,
    *,
    budget_s: float = PROBE_S,
    in_turns: bool = False,
) -> Probe:
    """Play the trials by which machines are compared, after warming up.

    They are four random genomes on two seeds. Of a simulator that is not repeatable, one trial is
    played.

    Args:
        most: trials to play.
        budget_s: seconds; what would take longer is left out, except for the first trial.
    """
    if not in_turns:
        compile_all()  # what this takes is not the time of a trial
    begin = time.perf_counter()
    parts = [warm_up(simulator, representation, in_turns=in_turns)]
    spent_s = trial_s = time.perf_counter() - begin
    if not simulator.repeatable:
        return Probe(b"", trial_s)
    played = 1
    while played < most:
        # One more first: the first one may have loaded something.
        count = 1 if played == 1 else most - played
        count = int(min(count, (budget_s - spent_s) // trial_s))
        if count < 1:
            break
        some = slice(played, played + count)
        parts.append(play_probe(simulator, representation, some, in_turns=in_turns))
        before_s, spent_s = spent_s, time.perf_counter() - begin
        trial_s = (spent_s - before_s) / count
        played += count
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
