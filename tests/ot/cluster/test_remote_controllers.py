"""Controllers that stay at the optimizer: answers and refusals for servers."""

import struct

import msgspec
import numpy as np
import pytest

from zswarm.evaluate import build
from zswarm.kernels.random import Stream
from zswarm.nets.networks import Networks
from zswarm.ot.cluster.remote_controllers import RemoteControllers
from zswarm.ot.workload import Workload
from zswarm.protocol import codec
from zswarm.protocol.messages import Actuators, Reaction, Sensors

SIMULATOR, NETWORK = build("minisim", {}, "hebbian", {})
GENOMES = NETWORK.random(3, Stream(1))
LEASE, PLAY = b"l" * 16, b"p" * 16
OBSERVED = np.linspace(0, 1, 2 * SIMULATOR.inputs, dtype=np.float32).reshape(2, -1)


@pytest.fixture
def controllers() -> RemoteControllers:
    """Return the controllers of a run whose server ``lab`` has two trials as batch 7."""
    made = RemoteControllers(NETWORK, 1)
    made.begin(Workload(GENOMES, np.arange(3).reshape(3, 1), np.zeros(3, np.uint64), 0))
    made.give("lab", LEASE, 7, np.array([1, 2]))
    return made


def sensors(
    number: int = 0,
    trial: int = 1,
    play: bytes = PLAY,
    lease: bytes = LEASE,
    batch: int = 7,
) -> Sensors:
    return Sensors(
        lease=lease,
        batch=batch,
        trial=trial,
        play=play,
        number=number,
        agents=struct.pack("<2I", 0, 5),
        participants=bytes(8),
        observations=OBSERVED.tobytes(),
    )


def ask(
    controllers: RemoteControllers, question: Sensors, server: str = "lab"
) -> Reaction:
    return codec.decode_reaction(controllers.react(server, codec.encode(question)))


def decided(reaction: Reaction) -> np.ndarray:
    assert isinstance(reaction, Actuators), reaction
    return codec.decided(reaction, 2, SIMULATOR.outputs)


def test_decisions_are_those_of_the_trials_genome_state_by_state(
    controllers: RemoteControllers,
) -> None:
    expected = Networks(NETWORK, NETWORK.parameters([GENOMES[2]]))
    answers = [decided(ask(controllers, sensors(number))) for number in range(4)]
    for answer in answers:
        assert np.array_equal(answer, expected.decide([0, 5], [0, 0], OBSERVED))
    assert not np.array_equal(answers[0], answers[3]), "this network remembers"
    assert not np.array_equal(answers[0], decided(ask(controllers, sensors(trial=0))))


def test_a_question_asked_again_gets_the_same_answer_and_changes_nothing(
    controllers: RemoteControllers,
) -> None:
    """This holds even if the batch was given again meanwhile."""
    expected = Networks(NETWORK, NETWORK.parameters([GENOMES[2]]))
    for number in range(4):
        once = expected.decide([0, 5], [0, 0], OBSERVED)
        for _ in range(3):
            assert np.array_equal(decided(ask(controllers, sensors(number))), once)
            controllers.give("lab", LEASE, 7, np.array([1, 2]))


def test_a_repeated_trial_begins_with_fresh_states(
    controllers: RemoteControllers,
) -> None:
    first = [decided(ask(controllers, sensors(number))) for number in range(3)]
    second = [
        decided(ask(controllers, sensors(number, play=b"q" * 16))) for number in range(3)
    ]
    assert np.array_equal(first, second)


@pytest.mark.parametrize(
    ("server", "changes", "code", "words"),
    [
        ("other", {}, "cancelled", "does not have such a batch"),
        ("lab", {"batch": 8}, "cancelled", "does not have such a batch"),
        ("lab", {"lease": b"x" * 16}, "cancelled", "does not have such a batch"),
        (
            "lab",
            {"number": 3},
            "cancelled",
            "question 3 came before the first one of its trial",
        ),
        ("lab", {"trial": 2}, "malformed", "trial 2 is not in a batch of 2"),
    ],
)
def test_a_question_about_a_batch_of_another_server_is_refused(
    controllers: RemoteControllers,
    server: str,
    changes: dict[str, object],
    code: str,
    words: str,
) -> None:
    refused = ask(controllers, msgspec.structs.replace(sensors(), **changes), server)
    assert (getattr(refused, "code", ""), words in getattr(refused, "reason", "")) == (
        code,
        True,
    ), refused


def test_a_question_out_of_order_is_refused_and_changes_nothing(
    controllers: RemoteControllers,
) -> None:
    ask(controllers, sensors(0))
    assert (
        getattr(ask(controllers, sensors(2)), "reason", "")
        == "question 2 came instead of question 1"
    )
    expected = Networks(NETWORK, NETWORK.parameters([GENOMES[2]]))
    expected.decide([0, 5], [0, 0], OBSERVED)
    assert np.array_equal(
        decided(ask(controllers, sensors(1))), expected.decide([0, 5], [0, 0], OBSERVED)
    )


def test_malformed_questions_are_refused_with_a_reason(
    controllers: RemoteControllers,
) -> None:
    for body in (b"", b"\xc1", codec.encode(Actuators(actions=b""))):
        assert (
            getattr(codec.decode_reaction(controllers.react("lab", body)), "code", "")
            == "malformed"
        )
    short = msgspec.structs.replace(sensors(), observations=bytes(4))
    assert "inputs need" in getattr(ask(controllers, short), "reason", "")


def test_questions_for_answered_batches_and_ended_workloads_are_refused(
    controllers: RemoteControllers,
) -> None:
    controllers.give("lab", LEASE, 8, np.array([0]))
    controllers.take_back("lab", 7)
    assert getattr(ask(controllers, sensors()), "code", "") == "cancelled"
    assert isinstance(ask(controllers, sensors(trial=0, batch=8)), Actuators)
    controllers.begin(
        Workload(GENOMES, np.arange(3).reshape(3, 1), np.zeros(3, np.uint64), 0)
    )
    assert getattr(ask(controllers, sensors(trial=0, batch=8)), "code", "") == "cancelled"
