"""What a run asks of servers, and the messages that ask it."""

import msgspec
import numpy as np
from msgspec import structs

from tests.ot.cluster.dispatching import Optimizer, lease, offer, terms
from zswarm import experiment
from zswarm.ot.cluster import matching
from zswarm.ot.cluster.dispatch import Dispatch
from zswarm.ot.cluster.events import Seen, Work
from zswarm.ot.problem import Problem
from zswarm.ot.workload import Workload
from zswarm.protocol import codec, messages
from zswarm.protocol.messages import Evaluate, Part, Renew, Reserve

OPTIONS = [
    "cluster.trial_timeout_s=7.5",
    "cluster.trial_memory_mb=512",
    "cluster.require=['gpu=yes']",
    "cluster.max_slots=9",
    "cluster.on_fault='quarantine'",
    "cluster.verify=0.5",
    "cluster.controller='optimizer'",
    "cluster.messages='agent'",
]


def test_options_of_an_experiment_become_terms() -> None:
    complete = experiment.complete(
        experiment.load(experiment.find("minisim"), OPTIONS), "test"
    )
    simulator = Problem(complete).simulator
    program = matching.RunProgram(3, b"secret")
    made = matching.terms(
        complete, complete.cluster, simulator, program, slots=5, probe=b"probe"
    )
    again = matching.terms(
        complete, complete.cluster, simulator, program, slots=5, probe=b"probe"
    )
    reserve, problem = made.reserve, complete.problem
    assert made.secret == b"secret"
    assert b"secret" not in codec.encode(reserve)
    assert reserve.nonce != again.reserve.nonce
    assert (reserve.epoch, reserve.slots, reserve.asks) == (3, 5, "agent")
    assert (reserve.trial_timeout_s, reserve.trial_memory_mb) == (7.5, 512)
    assert made.requirements.trial_memory_mb == 512
    assert reserve.simulator == Part("minisim", problem.settings)
    assert made.requirements.settings == problem.settings
    assert made.requirements.version_hash == reserve.version_hash != ""
    assert (made.choice.max_slots, list(map(str, made.choice.require))) == (
        9,
        ["gpu=yes"],
    )
    assert (made.quarantine, made.verify, made.probe) == (True, 0.5, b"probe")
    assert (made.participants, made.metrics) == (1, len(simulator.metrics))


def test_messages_carry_the_requirements_of_the_run() -> None:
    optimizer = Optimizer(slots=7)
    wanted = terms(7)
    (ask,) = optimizer.feed(Seen("a"))
    assert ask.message == wanted.requirements
    (ask,) = optimizer.answer(ask, offer(2))
    assert ask.message == structs.replace(wanted.reserve, slots=2)
    (ask,) = optimizer.answer(ask, lease("a", 1, slots=2))
    token = lease("a", 1).lease
    assert ask.message == Renew(lease=token, known_ready=1)
    optimizer.work(1)
    (cancel, evaluate) = optimizer.work(1)
    assert isinstance(cancel.message, messages.Cancel)
    assert isinstance(evaluate.message, Evaluate)
    assert cancel.message.lease == evaluate.message.lease == token


def test_an_evaluate_holds_the_genomes_of_its_trials_and_a_server_reads_them_in_order() -> (
    None
):
    optimizer = Optimizer()
    optimizer.join("a", slots=2)
    seeds = np.array([7, 8, 2**64 - 1], np.uint64)
    workload = Workload([b"a", b"b", b"c"], np.array([[2], [1], [0]]), seeds, 0)
    workload.counted[1] = True
    (ask,) = optimizer.feed(Work(workload))
    assert isinstance(ask.message, Evaluate)
    assert ask.message.genomes == [b"a", b"c"]
    participants, sent = codec.trials(ask.message, 1)
    assert (participants.tolist(), sent.tolist()) == ([[1], [0]], [7, 2**64 - 1])


def test_genomes_stay_where_the_controllers_stay() -> None:
    asking = msgspec.structs.replace(terms(), reserve=_asking(terms().reserve))
    optimizer = Optimizer()
    optimizer.dispatch = Dispatch(asking)
    optimizer.join("a")
    (ask,) = optimizer.work(1, genome=b"secret")
    assert isinstance(ask.message, Evaluate)
    assert ask.message.genomes == [b""]


def _asking(reserve: Reserve) -> Reserve:
    return msgspec.structs.replace(reserve, asks="turn")
