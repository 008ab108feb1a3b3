"""Senders: order, failures, blocked calls, and how many threads there are."""

import threading
import time
from collections.abc import Callable

import pytest

from zswarm.system import sending
from zswarm.system.sending import FEW, Sender, Threads


class Panic(BaseException):
    """What a panic in zenoh is in Python: no ``Exception``."""


def raised(error: BaseException) -> None:
    raise error


def wait_until(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < end, "not within 60 s"
        time.sleep(0.005)


def test_a_call_that_fails_is_reported_and_the_sender_continues() -> None:
    failed: list[BaseException] = []
    sent: list[int] = []
    threads = Threads()
    sender = Sender(threads, failed.append)

    def panic() -> None:
        raise Panic("no memory")

    for number in range(3):
        assert sender.send(panic)
        assert sender.send(lambda number=number: sent.append(number))
    sender.wait(60.0)
    assert sent == [0, 1, 2]
    assert [repr(error) for error in failed] == ["Panic('no memory')"] * 3
    threads.close()
    wait_until(lambda: threads._idle == 0)


def test_calls_of_many_senders_are_made_in_order_by_a_few_threads() -> None:
    threads = Threads()
    made: dict[int, list[int]] = {receiver: [] for receiver in range(50)}
    by: set[int] = set()
    senders = {receiver: Sender(threads, raised) for receiver in made}

    def make(receiver: int, number: int) -> None:
        made[receiver].append(number)
        by.add(threading.get_ident())

    for number in range(40):
        for receiver, sender in senders.items():
            sender.send(lambda r=receiver, n=number: make(r, n))
    for sender in senders.values():
        sender.wait(60.0)
    wait_until(lambda: not any(sender.busy for sender in senders.values()))
    assert all(numbers == list(range(40)) for numbers in made.values())
    assert len(by) <= FEW
    threads.close()


def test_blocked_calls_delay_those_of_no_other_receiver() -> None:
    """Seven links are dead: more threads are started until the eighth is served."""
    threads = Threads()
    ends, sent = threading.Event(), threading.Event()
    blocked = [Sender(threads, raised) for _ in range(7)]
    for sender in blocked:
        sender.send(ends.wait)  # type: ignore[arg-type]  # its answer is dropped
    free = Sender(threads, raised)
    free.send(sent.set)
    assert sent.wait(60.0)
    assert all(sender.busy for sender in blocked)
    again = threading.Event()
    free.send(again.set)
    assert again.wait(60.0)
    ends.set()
    for sender in blocked:
        sender.wait(60.0)
    threads.close()
    wait_until(lambda: threads._idle == 0)


def test_a_call_at_once_is_made_here_unless_others_wait() -> None:
    threads = Threads()
    sender = Sender(threads, raised)
    by: list[int] = []
    ends = threading.Event()
    here = threading.get_ident()
    sender.send(lambda: by.append(threading.get_ident()), at_once=True)
    assert by == [here]
    sender.send(ends.wait)  # type: ignore[arg-type]
    sender.send(lambda: by.append(threading.get_ident()), at_once=True)
    ends.set()
    sender.wait(60.0)
    assert by[1] != here
    wait_until(lambda: not sender.busy)
    with pytest.raises(KeyboardInterrupt):
        sender.send(lambda: raised(KeyboardInterrupt()), at_once=True)
    threads.close()


def test_too_many_waiting_calls_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sending, "MAX_WAITING", 2)
    threads = Threads()
    sender = Sender(threads, raised)
    ends, begun = threading.Event(), threading.Event()
    sender.send(begun.set)
    sender.send(ends.wait)  # type: ignore[arg-type]
    assert begun.wait(60.0)
    assert [sender.send(lambda: None) for _ in range(3)] == [True, True, False]
    ends.set()
    sender.wait(60.0)
    threads.close()


def test_without_threads_a_call_is_refused_and_later_ones_are_made(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    threads = Threads()
    sender = Sender(threads, raised)
    made: list[str] = []
    with monkeypatch.context() as no_threads:
        no_threads.setattr(threading.Thread, "start", lambda _: raised(RuntimeError()))
        with pytest.raises(RuntimeError):
            sender.send(lambda: made.append("first"))
    assert sender.send(lambda: made.append("second"))
    sender.wait(60.0)
    assert made == ["second"]
    threads.close()


def test_calls_are_made_where_no_further_thread_can_be_started(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    threads = Threads()
    ends, sent = threading.Event(), threading.Event()
    blocked = [Sender(threads, raised) for _ in range(FEW)]
    for sender in blocked:
        sender.send(ends.wait)  # type: ignore[arg-type]
    wait_until(lambda: threads._taken == FEW)
    with monkeypatch.context() as no_threads:
        no_threads.setattr(threading.Thread, "start", lambda _: raised(RuntimeError()))
        assert Sender(threads, raised).send(sent.set)
    ends.set()
    assert sent.wait(60.0)
    threads.close()
