"""New servers are asked together, once no more of them come."""

import math

from zswarm.ot.cluster.debounce import GATHER_S, QUIET_S, Newcomers


def test_a_single_newcomer_waits_briefly() -> None:
    new = Newcomers()
    assert (new.due, new.take(1e9)) == (math.inf, [])
    new.add("a", 1.0)
    assert new.due == 1.0 + QUIET_S
    assert new.take(1.0) == []
    assert new.take(1.0 + QUIET_S) == ["a"]
    assert (new.due, new.take(1e9)) == (math.inf, [])


def test_newcomers_wait_longer_the_longer_others_keep_coming() -> None:
    new = Newcomers()
    for number in range(101):
        new.add(number, 10.0 + number * 0.01)
    assert new.due == 11.0 + 0.5
    assert new.take(11.4) == []
    assert new.take(11.5) == list(range(101))


def test_newcomers_do_not_wait_forever() -> None:
    new = Newcomers()
    number = 0
    while number * 0.01 < new.due:
        new.add(number, number * 0.01)
        number += 1
    assert new.due == GATHER_S
    assert new.take(GATHER_S) == list(range(number))


def test_newcomers_that_left_are_not_asked() -> None:
    new = Newcomers()
    new.add("a", 0.0)
    new.add("b", 0.0)
    new.remove("a")
    new.remove("never there")
    assert new.take(1.0) == ["b"]
    new.add("c", 2.0)
    new.remove("c")
    assert (new.due, new.take(9.0)) == (math.inf, [])
