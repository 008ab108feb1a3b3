"""Events of a run that are worth a record and a line for the user.

Their names are data: they are in the table ``events`` of records, and in JSON.
"""

from enum import StrEnum
from typing import Literal

import msgspec

from zswarm.system.format import plural

Severity = Literal["info", "warning", "error"]


class RunEvent(StrEnum):
    """An event of a run: its name, its severity, and the line that reports it to a user, if any."""

    BEGAN = "began"  # the run, or resumed
    DIAGNOSIS = "diagnosis", "warning", "{text}"
    SERVER_JOINED = "server_joined", "info", "{server} joined with {slots}"
    SERVER_SLOTS = "server_slots"
    SERVER_SPARE = "server_spare"
    SERVER_LEFT = "server_left", "warning", "{server} left with {text}"
    SERVER_LOST = "server_lost", "error", "{server} is gone"
    SERVER_BACK = "server_back", "info", "{server} is back"
    SERVER_MISMATCH = "server_mismatch", "warning", "{server} is not used: {text}"
    SERVER_REFUSED = "server_refused", "warning", "{server} refused: {text}"
    SERVER_DIFFERS = "server_differs", "warning", "{server} is not used yet: {text}"
    SERVER_FAULTY = (
        "server_faulty",
        "error",
        "{server} is backed off for ten minutes: {text}",
    )
    SERVER_WRONG = (
        "server_wrong",
        "error",
        "{server} is banned: {text}; what its machine did in this generation, or round of games, "
        "is evaluated again, and marked as doubtful in earlier ones",
    )
    SERVER_UNPREPARED = (
        "server_unprepared",
        "warning",
        "{server} cannot prepare the problem: {text}; next attempt in {count} s",
    )
    SERVER_STALLED = (
        "server_stalled",
        "warning",
        "{server} is backed off: {text}; next attempt in {count} s",
    )
    ANSWER_FAILED = (
        "answer_failed",
        "error",
        "{server} is backed off: its answer could not be handled: {text}; next attempt in "
        "{count} s",
    )
    SERVER_BANNED = "server_banned", "warning", "{server} is not used: {text}"
    # By the user, who trusts a machine again that was banned.
    SERVER_TRUSTED = "server_trusted", "warning", "{text}"
    # The text is the digest of the trials that this machine played.
    PROBE_ARBITRATED = "probe_arbitrated"
    SERVER_SILENT = (
        "server_silent",
        "warning",
        "{server} does not answer ({text}); it is asked again later",
    )
    UNVERIFIED = "unverified", "warning", "trials are counted unverified: {text}"
    LEASE_LOST = "lease_lost", "error", "{server}: {text}; reserving again"
    LEASE_WAITING = (
        "lease_waiting",
        "info",
        "{server} is busy for other runs: waiting for a slot",
    )
    LEASE_PREPARING = "lease_preparing"
    LEASE_READY = "lease_ready"
    DISK_WAITED = "disk_waited", "warning"
    REQUEUED = "requeued", "warning"
    SECOND_START = "second_start"
    FAULT = "fault", "error", "{server}: {text}"
    MALFORMED = (
        "malformed",
        "error",
        "{server} sent an answer that cannot be used: {text}",
    )
    SIMULATOR_RAISED = (
        "simulator_raised",
        "error",
        "the simulator failed on {server}: {text} ({count} trials)",
    )
    SIMULATOR_LEFT = (
        "simulator_left",
        "warning",
        "a trial on {server} left something in its process: {text}; later trials are played in a "
        "new process, which takes time",
    )

    severity: Severity
    line: str

    def __new__(
        cls, name: str, severity: Severity = "info", line: str = ""
    ) -> "RunEvent":
        """Make a member, which equals its name."""
        member = str.__new__(cls, name)
        member._value_, member.severity, member.line = name, severity, line
        return member


def severity(event: str) -> Severity:
    """Return the severity of an event by its name, which may come from a damaged record."""
    return RunEvent(event).severity if event in set(RunEvent) else "info"


class Note(msgspec.Struct, frozen=True):
    """An event, the server that it is about, and its details."""

    event: str  # the name of an ``RunEvent``
    server: str = ""
    text: str = ""
    count: int = 0
    machine: str = ""  # of the server, where that matters


def words(note: Note) -> str:
    """Return the line for the user; "" if there is none."""
    slots = plural(note.count, "slot")
    line = RunEvent(note.event).line
    return line.format(server=note.server, text=note.text, count=note.count, slots=slots)
