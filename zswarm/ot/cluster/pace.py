"""How fast a server is: its trials, its round trip, and its link.

All is measured by this machine's clock and by the seconds that servers report to have computed, so
clocks need not agree. Most errors make a measurement too high: a machine that is busy for a moment,
trials of unequal length. So what is measured of a link falls at once and rises slowly.
"""

import math

import msgspec

SMOOTHING = (
    0.3  # weight of the last measurement of a trial, and of one of a link that is higher
)
# Of what an answer took beyond its trials and a round trip: not of its bytes.
JITTER_S = 0.005
JITTER_SHARE = 0.5  # the same, as a share of the time of its trials
LONGEST_S = 5.0  # that a round trip is taken to last: the clock may have jumped
# A batch of fewer bytes does not show how fast a link is.
MEASURABLE_BYTES = 4_000
# Assumed of a link until it is measured, or less if a short message and its answer took less: the
# first batch shows how slow it is, and is small.
UNKNOWN_BYTE_S, SHORT_BYTES = 1e-5, 500
FIRST_BATCH_S = 0.16


class Pace(msgspec.Struct, eq=False):
    """What was measured of a server."""

    trial_s: float = 0.0  # of a trial on one slot; 0.0: not measured yet
    round_trip_s: float = 0.0  # of a short message and its answer
    byte_s: float = 0.0  # of a byte on the link
    link_measured: bool = False
    sent_by: float = -math.inf  # when what was sent is expected to be through the link
    batch_at: float = -math.inf  # when it was last sent a batch
    outdated: bool = False  # what is known of its trials is long ago

    def computed(self, seconds: float, trials: int) -> None:
        """Take the seconds that its slots computed for some trials."""
        measured = seconds / trials
        if self.trial_s and not self.outdated:
            measured = (1 - SMOOTHING) * self.trial_s + SMOOTHING * measured
        self.trial_s, self.outdated = measured, False

    def asked(self, seconds: float, *, held: bool = False) -> None:
        """Take the time that a short message took until it was answered.

        Args:
            held: the server may have held the answer back.
        """
        known = self.round_trip_s or math.inf
        measured = min(known, seconds) if held else _lower(known, seconds)
        self.round_trip_s = min(measured, LONGEST_S)
        if not self.link_measured:
            slow_s = max(0.0, self.round_trip_s - JITTER_S)
            self.byte_s = min(UNKNOWN_BYTE_S, slow_s / SHORT_BYTES)

    def batch_answered(self, elapsed: float, trials_s: float, size: int) -> None:
        """Take the time that a batch took when nothing else was with the server.

        Args:
            trials_s: of it, in which trials were computed.
            size: bytes of the batch.
        """
        if size < MEASURABLE_BYTES:
            self.asked(max(0.0, elapsed - trials_s))
            self.byte_s = self.byte_s if self.link_measured else 0.0
        else:
            measured = max(0.0, self._on_link(elapsed, trials_s)) / size
            known = self.byte_s if self.link_measured else math.inf
            self.byte_s = _lower(known, measured)
        self.link_measured = True

    def batch_overtaken(self, elapsed: float, trials_s: float, size: int) -> None:
        """Take the time in which a batch was not answered: the link is at least as slow."""
        at_least = self._on_link(elapsed, trials_s) / size
        if size >= MEASURABLE_BYTES and at_least > self.byte_s:
            self.byte_s, self.link_measured = at_least, True

    def trials_s(self, trials: int, slots: int) -> float:
        """Return the time that some trials take on some slots that are idle."""
        return self.trial_s * math.ceil(trials / max(1, slots))

    def each_s(self, slots: int, size: float) -> float:
        """Return the time between outcomes while all is busy.

        Args:
            size: bytes of a trial on the link.
        """
        return max(self.trial_s / slots, self.byte_s * size)

    def first_trials(self, size: float) -> int:
        """Return how many trials may be with the server until its link is measured."""
        seconds = max(self.trial_s, FIRST_BATCH_S)
        return max(1, int(seconds / (size * UNKNOWN_BYTE_S)))

    def _on_link(self, elapsed: float, trials_s: float) -> float:
        computed = trials_s * (1 + JITTER_SHARE)
        return elapsed - computed - self.round_trip_s - JITTER_S


def _lower(known: float, measured: float) -> float:
    if measured <= known:
        return measured
    return known + SMOOTHING * (measured - known)
