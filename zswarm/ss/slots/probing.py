"""How a lease plays the probe: the trials by which machines are compared, on all of its slots.

The first slot of a lease compiles; when nothing is left to compile, the others are prepared, too. A
slot that is prepared plays a trial, which loads all that trials need: each slot another trial of
the probe. The first slot plays all of them if they are short. What is missing then is divided
among the slots, as far as it fits into ``PROBE_S``.

The probe is known when nothing of it is played any more, or when that time is over: the digests of
its first trials, in order, one at least.
"""

import math
from collections.abc import Collection

import msgspec

from zswarm.protocol.messages import PROBE_DIGEST, PROBE_TRIALS
from zswarm.ss.slots.events import Prepared, Preparing

PROBE_S = 10.0  # that the probe may take, except for its first trial


class ProbeTrials(msgspec.Struct, eq=False):
    """The trials of the probe that the slots of a lease play."""

    trials: int = PROBE_TRIALS  # 1 if the simulator is not repeatable
    compiling: int = 0  # kernels that are not compiled
    kernels: int = 0  # that were to be compiled
    compiled: bool = False  # all slots find what is to be compiled
    trial_s: float = 0.0  # of a trial; of one that loaded nothing, if there is any
    _loading: bool = True  # there is none
    _begun_at: float = 0.0
    _begun: int = 0  # trials
    _digests: dict[int, bytes] = {}  # by trial

    def prepare(self, playing: Collection[int], now: float) -> tuple[int, int]:
        """Return the trial that a slot plays first, and how many it may play if they are short."""
        alone = not self._digests and not playing
        missing = self._missing(playing)
        first = missing[0] if missing else 0
        self._begin(first, 1, now)
        return first, self.trials if alone else 1

    def built(self, event: Preparing, now: float) -> None:
        """Take note of what a slot compiles, and how many trials there are."""
        self.trials = event.probe_trials
        self.compiling, self.kernels = event.compiling, event.kernels
        if not self.compiling and not self.compiled:
            self.compiled, self._begun_at = True, now

    def played(self, event: Prepared) -> None:
        """Take the trials that a slot played."""
        self.compiled, self.compiling = True, 0
        if not event.probe:  # it is not repeatable
            self.trials, self._digests = 1, {0: b""}
        count = len(event.probe) // PROBE_DIGEST
        for at in range(count):
            digest = event.probe[at * PROBE_DIGEST : (at + 1) * PROBE_DIGEST]
            self._digests.setdefault(event.first + at, digest)
        self._begun = max(self._begun, event.first + count)
        loaded = event.loaded or count > 1
        if loaded or self._loading:
            self.trial_s, self._loading = event.trial_s, not loaded

    def next(self, playing: Collection[int], slots: int, now: float) -> range:
        """Return the trials for a slot that is prepared; none if there is no time for them."""
        missing = self._missing(playing)
        if not missing:
            return range(0)
        first = missing[0]
        if not self._digests:
            count = 1
        else:
            in_a_row = sum(trial == first + at for at, trial in enumerate(missing))
            count = min(in_a_row, math.ceil(len(missing) / slots))
            left_s = max(0.0, self._begun_at + PROBE_S - now)
            if self.trial_s:
                count = int(min(count, left_s / self.trial_s))
            if first == 0:
                count = max(1, count)
        self._begin(first, count, now)
        return range(first, first + count)

    def known(self, playing: Collection[int], now: float) -> bool:
        """Return whether nothing of it is awaited any more; call it after ``next``."""
        over = now >= self._begun_at + PROBE_S
        awaited = [
            one for one in playing if one < self.trials and one not in self._digests
        ]
        return 0 in self._digests and (over or not awaited)

    def digest_known(self) -> bool:
        """Return whether any slot played a trial."""
        return bool(self._digests)

    def digest(self) -> bytes:
        """Return the digests of the first trials, in order."""
        found: list[bytes] = []
        while len(found) in self._digests:
            found.append(self._digests[len(found)])
        return b"".join(found)

    def progress(self) -> tuple[int, int, int, int]:
        """Return how far it is, as in ``LeaseProgress``."""
        if self.compiling:
            return self.compiling, 0, 0, self.kernels
        begun = min(self._begun, self.trials)
        return (0, begun, self.trials, 0) if self.compiled else (0, 0, 0, 0)

    def _missing(self, playing: Collection[int]) -> list[int]:
        """Return the trials that no slot plays or played."""
        trials = range(self.trials)
        return [one for one in trials if one not in self._digests and one not in playing]

    def _begin(self, first: int, count: int, now: float) -> None:
        if not self._begun:
            self._begun_at = now
        self._begun = max(self._begun, first + count)
