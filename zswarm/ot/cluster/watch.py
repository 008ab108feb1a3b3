"""Report to a user why nothing is evaluated, and end what cannot be evaluated."""

import threading
import time
from collections.abc import Callable

import msgspec

from zswarm.config.sections import ClusterConfig
from zswarm.errors import EvaluationError
from zswarm.ot.cluster.events import Counted
from zswarm.ot.cluster.local import LocalServer
from zswarm.ot.cluster.remote_server import Standing
from zswarm.ot.notes import Note, RunEvent
from zswarm.system.format import duration, plural

PREPARING_S = 1.0  # of a server, before it is reported
PAUSE_S = 3.0  # without any server, before it is reported
QUIET_S = 60.0  # without an outcome of the servers that compute, before it is reported
# Between two lines about what is waited for: in its first minute, and later.
AGAIN_S, LATER_S = 1.5, 60.0
HINT = "zswarm-ot doctor explains why, docs/network.md what to do"
REFUSALS = (
    RunEvent.SERVER_REFUSED,
    RunEvent.SERVER_MISMATCH,
    RunEvent.SERVER_BANNED,
)
STARTING = "starting the slots of this machine"
NOBODY_YET = "waiting for the first slot to be ready (Ctrl-C stops; nothing is lost)"
NOBODY = "waiting for a server: none computes now (Ctrl-C stops; nothing is lost)"


class Watch(msgspec.Struct, eq=False):
    """Follows one run's servers, in the caller's thread."""

    options: ClusterConfig
    simulator: str  # its name, for the user
    local: LocalServer | None  # this machine's slots
    hinted: threading.Event  # set once the user knows that no server is found
    say: Callable[[str], None]  # takes a line for the user
    wait: Callable[[str], None]  # takes a line about what is waited for
    check: Callable[[], None]  # raises Stopped when the run is to end
    _begun: float = msgspec.field(default_factory=time.monotonic)
    _met: bool = False  # a server of the network
    _ever_served: bool = False
    # When servers computed last, or the workload began.
    _served_at: float = msgspec.field(default_factory=time.monotonic)
    # When an outcome was counted last, servers began to compute, or the workload began.
    _heard_at: float = msgspec.field(default_factory=time.monotonic)
    _served: bool = False
    _said: str = ""
    _waiting: str = ""  # for what, as last reported
    _again_at: float = 0.0

    def begin(self) -> None:
        """Begin with another workload."""
        self._heard_at = self._served_at = time.monotonic()
        self._served, self._said, self._waiting = False, "", ""

    def hint(self, item: object, standing: Standing) -> None:
        """Report once that no server is found, if other machines are asked for.

        Start this machine's slots again if something killed them.

        Raises:
            EvaluationError: this machine's slots refused, and no others can be expected.
            Stopped: the run is to end.
        """
        self.check()
        options, local = self.options, self.local
        if local is not None and (line := local.start_again()):
            self.say(line)
            self.begin()
        if isinstance(item, Note):
            self._take_note(item, standing)
        silent = self._met or self.hinted.is_set() or options.servers == "local"
        if not silent and time.monotonic() >= self._begun + PAUSE_S:
            self.hinted.set()
            alone = "; using this machine's slots only" if local is not None else ""
            self.say(f"no server found in realm {options.realm}{alone}; {HINT}")

    def _take_note(self, item: Note, standing: Standing) -> None:
        own = item.server in standing.own
        self._met = self._met or bool(item.server and not own)
        others = bool(self.options.require) and self.options.servers != "local"
        # Slots that were ready before may be again.
        unready = item.event == RunEvent.SERVER_UNPREPARED and not self._ever_served
        refused = own and (item.event in REFUSALS or unready)
        if refused and not others and self.local is not None and not standing.serving:
            raise EvaluationError(item.text)

    def report(self, item: object, standing: Standing) -> bool:
        """Report what a run waits for; return whether to find out why.

        Raises:
            EvaluationError: this machine's slots refused or ended.
            Stopped: the run is to end.
        """
        self.hint(item, standing)
        now = time.monotonic()
        local, idle_s = self.local, now - self._served_at
        if isinstance(item, Counted) or not standing.serving:
            self._heard_at = now
        if standing.serving:
            self._served_at, self._said = now, ""
            self._served = self._ever_served = True
            if now >= self._heard_at + QUIET_S:
                compute = plural(standing.slots, "slot")
                self._wait(f"no outcome from {compute} yet", now - self._heard_at)
            else:
                self._waiting = ""
        elif local is not None and (words := local.ended()):
            raise EvaluationError(f"the slots of this machine ended: {words}")
        elif standing.preparing:
            if idle_s > PREPARING_S:
                self._wait(self._preparing(standing), idle_s)
        elif local is not None and not (self._ever_served or standing.own):
            if idle_s > PREPARING_S:
                self._wait(STARTING, idle_s)
        elif idle_s > PAUSE_S and self._said not in (NOBODY, NOBODY_YET):
            self._tell(NOBODY if self._served or local is None else NOBODY_YET)
            return local is None
        return False

    def _preparing(self, standing: Standing) -> str:
        """Return what the first server does that prepares a slot; or just that some do."""
        first = standing.preparing[0]
        here = "" if first in standing.own else f"{first}: "
        if standing.progress is not None:
            return here + standing.progress.words(self.simulator)
        known = self._waiting if self._waiting != STARTING else ""
        return known or f"{here}getting {self.simulator} ready"

    def _wait(self, line: str, idle_s: float) -> None:
        """Report what is waited for and since when: again now and then, for it may take long."""
        now = time.monotonic()
        if line != self._waiting or now >= self._again_at:
            self._waiting = line
            self._again_at = now + (AGAIN_S if idle_s < LATER_S else LATER_S)
            self.wait(f"{line} ({duration(round(idle_s))})")

    def _tell(self, line: str) -> None:
        if line != self._said:
            self._said = line
            self.say(line)
