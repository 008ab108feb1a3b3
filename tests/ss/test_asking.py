"""How slots ask the optimizer: one question at a time, asked again until it is answered or nobody wants the answer any more."""

import multiprocessing
import threading
from collections.abc import Sequence

import numpy as np
import pytest

from zswarm.protocol import codec
from zswarm.protocol.messages import Actuators, Asks, Evaluate, Refused, Sensors
from zswarm.ss.asking import AGAIN_S, AT_ONCE, NOBODY, Asking, Trial, Unanswered

BATCH = Evaluate(lease=b"l" * 16, batch=7, genomes=[b""], participants=bytes(4), seeds=bytes(8))
OBSERVED = np.arange(6, dtype=np.float32).reshape(3, 2)
RUN = ("ann", "run-1")


# ---- in a slot's process


def played(answers: Sequence[Actuators | Refused], asks: Asks) -> tuple[list[Sensors], list[np.ndarray]]:
    """What is asked in two turns of three agents, and what they do."""
    here, there = multiprocessing.Pipe()
    asked: list[Sensors] = []

    def answer() -> None:
        for one in answers:
            frame = there.recv_bytes()
            assert frame[:1] == b"S"
            asked.append(codec.decode_sensors(frame[1:]))
            there.send_bytes(codec.encode(one))

    thread = threading.Thread(target=answer)
    thread.start()
    trial = Trial(here, BATCH, 4, 1, asks)
    try:
        actions = [trial.decide([5, 0, 2], [1, 0, 1], OBSERVED) for _ in range(2)]
    finally:
        thread.join()
    return asked, actions


def actuators(*numbers: float) -> Actuators:
    return Actuators(actions=np.array(numbers, "<f4").tobytes())


def test_a_turn_is_one_question() -> None:
    asked, actions = played([actuators(1, 2, 3), actuators(4, 5, 6)], "turn")
    assert [(one.lease, one.batch, one.trial, one.number) for one in asked] == [(b"l" * 16, 7, 4, number) for number in (0, 1)]
    assert len({one.play for one in asked}) == 1
    agents, participants, observations = codec.sensed(asked[0], 2, 2)
    assert (agents, participants, observations.tolist()) == ([5, 0, 2], [1, 0, 1], OBSERVED.tolist())
    assert [array.tolist() for array in actions] == [[[1], [2], [3]], [[4], [5], [6]]]


def test_each_agent_is_one_question() -> None:
    asked, actions = played([actuators(number) for number in range(6)], "agent")
    assert [one.number for one in asked] == list(range(6))
    sensed = [codec.sensed(one, 2, 2) for one in asked[:3]]
    assert [agents for agents, _, _ in sensed] == [[5], [0], [2]]
    assert np.array_equal(np.concatenate([observed for _, _, observed in sensed]), OBSERVED)
    assert [array.tolist() for array in actions] == [[[0], [1], [2]], [[3], [4], [5]]]


def test_a_refusal_ends_the_trial_with_its_reason() -> None:
    with pytest.raises(Unanswered, match="not yours") as raised:
        played([Refused(code="cancelled", reason="not yours")], "turn")
    assert raised.value.refused.code == "cancelled"


# ---- in the server


class Sent:
    """What is sent, and what slots are told."""

    def __init__(self) -> None:
        self.questions: list[tuple[int, bytes, bool]] = []
        self.told: list[tuple[int, bytes]] = []
        self.asking = Asking(self._send, lambda slot, body: self.told.append((slot, body)))

    def _send(self, run: tuple[str, str], number: int, body: bytes, at_once: bool) -> None:
        assert run == RUN
        self.questions.append((number, body, at_once))


@pytest.fixture
def sent() -> Sent:
    return Sent()


def test_an_answer_goes_to_the_slot_that_asked_once(sent: Sent) -> None:
    sent.asking.ask(3, RUN, b"a")
    sent.asking.ask(1, RUN, b"b")
    (first, _, _), (second, _, _) = sent.questions
    for question in (second, first, first, second):
        sent.asking.answer(question, b"answer %d" % question)
    assert sent.told == [(1, b"answer %d" % second), (3, b"answer %d" % first)]


def test_a_question_that_nobody_heard_is_asked_again_and_again(sent: Sent) -> None:
    sent.asking.ask(0, RUN, b"a")
    number, now = sent.questions[0][0], 100.0
    for pause in (*AGAIN_S, AGAIN_S[-1]):
        sent.asking.unheard(number, now)
        assert sent.asking.next_time() == now + pause
        sent.asking.ask_again(now + pause / 2)
        assert sent.asking.next_time() == now + pause, "not before its time"
        now += pause
        sent.asking.ask_again(now)
        assert sent.asking.next_time() == float("inf")
    assert sent.questions[1:] == [(number, b"a", False)] * 4, "by the sender's thread: the link may hang"
    sent.asking.answer(number, b"answer")
    sent.asking.unheard(number, now)
    assert (sent.told, sent.asking.next_time()) == ([(0, b"answer")], float("inf"))


def test_a_slot_that_is_told_to_stop_waits_no_more(sent: Sent) -> None:
    sent.asking.stop(0)
    sent.asking.ask(0, RUN, b"a")
    sent.asking.stop(0)
    sent.asking.stop(0)
    sent.asking.answer(sent.questions[0][0], b"late")
    assert sent.told == [(0, NOBODY)]
    assert isinstance(codec.decode_reaction(NOBODY), Refused)


def test_a_late_answer_is_not_for_the_process_that_comes_after(sent: Sent) -> None:
    sent.asking.ask(0, RUN, b"a")
    sent.asking.forget(0)
    sent.asking.ask(0, RUN, b"b")
    (old, _, _), (new, _, _) = sent.questions
    sent.asking.answer(old, b"late")
    sent.asking.answer(new, b"new")
    assert sent.told == [(0, b"new")]


def test_more_than_zenoh_takes_without_waiting_goes_by_the_senders_thread(sent: Sent) -> None:
    size = AT_ONCE // 3
    for slot in range(4):
        sent.asking.ask(slot, RUN, bytes(size))
    assert [at_once for _, _, at_once in sent.questions] == [True, True, False, False]
