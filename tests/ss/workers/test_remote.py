"""Questions to the optimizer: one at a time for each slot, asked again until it is answered."""

import select
import threading
from collections.abc import Sequence

import numpy as np
import pytest

from zswarm.protocol import codec
from zswarm.protocol.messages import Actuators, Asks, Evaluate, Refused, Sensors
from zswarm.ss.workers import frames
from zswarm.ss.workers.remote import (
    AGAIN_S,
    AT_ONCE,
    CANCELLED,
    Questions,
    Trial,
    Unanswered,
)

BATCH = Evaluate(
    lease=b"l" * 16, batch=7, genomes=[b""], participants=bytes(4), seeds=bytes(8)
)
OBSERVED = np.arange(6, dtype=np.float32).reshape(3, 2)
RUN = ("ann", "run-1")


# ---- in a slot's process


def played(
    answers: Sequence[Actuators | Refused], asks: Asks
) -> tuple[list[Sensors], list[np.ndarray]]:
    """Play two turns of three agents; return the questions and the agents' actions."""
    here, there = frames.new_pipe(b"12345678")
    asked: list[Sensors] = []

    def answer() -> None:
        for one in answers:
            while (question := here.receive()) is None:
                select.select([here], [], [])
            asked.append(codec.decode_sensors(question))
            assert here.send(codec.encode(one))

    thread = threading.Thread(target=answer)
    thread.start()
    end = frames.ProcessEnd(there, b"12345678")
    trial = Trial(end, BATCH, 4, 1, asks)
    try:
        actions = [trial.decide([5, 0, 2], [1, 0, 1], OBSERVED) for _ in range(2)]
    finally:
        thread.join()
        here.close()
        end.close()
    return asked, actions


def actuators(*numbers: float) -> Actuators:
    return Actuators(actions=np.array(numbers, "<f4").tobytes())


def test_a_turn_sends_one_question() -> None:
    asked, actions = played([actuators(1, 2, 3), actuators(4, 5, 6)], "turn")
    assert [(one.lease, one.batch, one.trial, one.number) for one in asked] == [
        (b"l" * 16, 7, 4, number) for number in (0, 1)
    ]
    assert len({one.play for one in asked}) == 1
    agents, participants, observations = codec.sensed(asked[0], 2, 2)
    assert (agents, participants, observations.tolist()) == (
        [5, 0, 2],
        [1, 0, 1],
        OBSERVED.tolist(),
    )
    assert [array.tolist() for array in actions] == [[[1], [2], [3]], [[4], [5], [6]]]


def test_each_agent_sends_one_question() -> None:
    asked, actions = played([actuators(number) for number in range(6)], "agent")
    assert [one.number for one in asked] == list(range(6))
    sensed = [codec.sensed(one, 2, 2) for one in asked[:3]]
    assert [agents for agents, _, _ in sensed] == [[5], [0], [2]]
    assert np.array_equal(
        np.concatenate([observed for _, _, observed in sensed]), OBSERVED
    )
    assert [array.tolist() for array in actions] == [[[0], [1], [2]], [[3], [4], [5]]]


def test_a_refusal_ends_the_trial_with_its_reason() -> None:
    with pytest.raises(Unanswered, match="not yours") as raised:
        played([Refused(code="cancelled", reason="not yours")], "turn")
    assert raised.value.refused.code == "cancelled"


# ---- in the server


class Sent:
    """Collect the questions that are sent and the answers that slots are told."""

    def __init__(self) -> None:
        self.questions: list[tuple[int, bytes, bool]] = []
        self.told: list[tuple[int, bytes]] = []
        self.pending = Questions(
            self._send, lambda slot, body: self.told.append((slot, body))
        )

    def _send(
        self, run: tuple[str, str], number: int, body: bytes, _: object, at_once: bool
    ) -> None:
        assert run == RUN
        self.questions.append((number, body, at_once))


@pytest.fixture
def sent() -> Sent:
    return Sent()


def test_an_answer_goes_once_to_the_slot_that_asked(sent: Sent) -> None:
    sent.pending.ask(3, RUN, b"a")
    sent.pending.ask(1, RUN, b"b")
    (first, _, _), (second, _, _) = sent.questions
    for question in (second, first, first, second):
        sent.pending.answer(question, b"answer %d" % question)
    assert sent.told == [(1, b"answer %d" % second), (3, b"answer %d" % first)]


def test_a_lost_question_is_repeated(sent: Sent) -> None:
    sent.pending.ask(0, RUN, b"a")
    number, now = sent.questions[0][0], 100.0
    for pause in (*AGAIN_S, AGAIN_S[-1]):
        sent.pending.unheard(number, now)
        assert sent.pending.next_time() == now + pause
        sent.pending.ask_again(now + pause / 2)
        assert sent.pending.next_time() == now + pause, "not before its time"
        now += pause
        sent.pending.ask_again(now)
        assert sent.pending.next_time() == float("inf")
    assert sent.questions[1:] == [(number, b"a", False)] * 4, (
        "by the sender's thread: the link may hang"
    )
    sent.pending.answer(number, b"answer")
    sent.pending.unheard(number, now)
    assert (sent.told, sent.pending.next_time()) == ([(0, b"answer")], float("inf"))


def test_the_question_of_a_slot_that_is_to_stop_is_cancelled(sent: Sent) -> None:
    sent.pending.stop(0)
    sent.pending.ask(0, RUN, b"a")
    sent.pending.stop(0)
    sent.pending.stop(0)
    sent.pending.answer(sent.questions[0][0], b"late")
    assert sent.told == [(0, CANCELLED)]
    assert isinstance(codec.decode_reaction(CANCELLED), Refused)


def test_a_late_answer_does_not_reach_the_next_process(sent: Sent) -> None:
    sent.pending.ask(0, RUN, b"a")
    sent.pending.forget(0)
    sent.pending.ask(0, RUN, b"b")
    (old, _, _), (new, _, _) = sent.questions
    sent.pending.answer(old, b"late")
    sent.pending.answer(new, b"new")
    assert sent.told == [(0, b"new")]


def test_questions_that_would_block_are_sent_by_the_senders_thread(sent: Sent) -> None:
    size = AT_ONCE // 3
    for slot in range(4):
        sent.pending.ask(slot, RUN, bytes(size))
    assert [at_once for _, _, at_once in sent.questions] == [True, True, False, False]
