"""Questions of the dispatch as messages."""

import numpy as np
import pytest

from zswarm.ot.dispatch import Ask, Verb
from zswarm.ot.matching import Choice
from zswarm.ot.requests import Wanted, Who, request
from zswarm.ot.workload import Workload
from zswarm.protocol import codec, messages
from zswarm.protocol.messages import Part

LEASE = bytes(range(16))
WHO = Who("lab", "ada", "run-1", 3, b"n" * 16)
REQUIREMENTS = messages.Requirements(
    simulator="minisim", representation="fully-meshed", version_hash="abc", trial_memory_mb=512, settings={"steps": 3},
    versions={"numpy": "2.3.0"},
)  # fmt: skip
WANTED = Wanted(
    REQUIREMENTS, Choice(),
    Part("minisim", {"steps": 3}), Part("fully-meshed", {"hidden": 1}), 1, 0, 60.0, trial_memory_mb=512, slots=7,
    quarantine=False, verify=0.0, probe=b"",
)  # fmt: skip


def ask(verb: Verb) -> Ask:
    return Ask(1, "lab-1", verb, LEASE, batch=9, trials=np.array([2, 0]), slots=5, known_ready=4, batches=(5, 6))


@pytest.mark.parametrize(
    ("verb", "message"),
    [
        ("offer", REQUIREMENTS),
        (
            "reserve",
            messages.Reserve(
                nonce=WHO.nonce, epoch=3, slots=5, simulator=WANTED.simulator, representation=WANTED.representation,
                version_hash="abc", trial_timeout_s=60.0, trial_memory_mb=512,
            ),
        ),
        ("renew", messages.Renew(lease=LEASE, known_ready=4)),
        ("cancel", messages.Cancel(lease=LEASE, batches=[5, 6])),
        ("release", messages.Release(lease=LEASE)),
    ],
)  # fmt: skip
def test_a_question_says_what_the_run_wants(verb: Verb, message: messages.Request) -> None:
    assert request(ask(verb), WHO, WANTED, None) == message


def test_an_evaluate_holds_the_genomes_of_its_trials_and_a_server_reads_them_in_order() -> None:
    workload = Workload([b"a", b"b", b"c"], np.array([[0], [1], [2]]), np.array([7, 8, 2**64 - 1], np.uint64), 0)
    message = request(ask("evaluate"), WHO, WANTED, workload)
    assert isinstance(message, messages.Evaluate)
    assert (message.lease, message.batch, message.genomes) == (LEASE, 9, [b"a", b"c"])
    participants, seeds = codec.trials(message, 1)
    assert (participants.tolist(), seeds.tolist()) == ([[1], [0]], [2**64 - 1, 7])
