"""What a server shows of itself."""

from zswarm.ss.local.snapshot import RATE_S, Rate


def test_a_rate_covers_the_last_seconds() -> None:
    rate = Rate(100.0)
    assert rate.take(0, 100.0) == 0.0
    assert rate.take(50, 100.5) == 50.0, "at the start over a second at least"
    for step in range(1, 101):
        steady = rate.take(50 + 10 * step, 100.5 + 0.1 * step)
    assert abs(steady - 100.0) < 10.0
    assert rate.take(1050, 110.5 + RATE_S) == 0.0, "nothing came since"


def test_a_long_pause_does_not_lower_the_rate_of_later_work() -> None:
    rate = Rate(0.0)
    assert rate.take(0, 3600.0) == 0.0
    assert rate.take(100, 3600.1) == 100.0 / RATE_S
    assert rate.take(200, 3600.2) == 200.0 / RATE_S
    assert rate.take(200, 3609.0) == 200.0 / RATE_S
    assert rate.take(200, 3621.0) == 0.0
