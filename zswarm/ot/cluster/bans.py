"""Servers that compute wrong outcomes are banned; those that fail too many are backed off."""

import msgspec

from zswarm.ot.cluster.events import Outbox, ProbeDisputed, Retracted
from zswarm.ot.cluster.remote_server import Phase, RemoteServer
from zswarm.ot.cluster.servers import BACK_OFF_S, PAUSE_S, Servers
from zswarm.ot.notes import RunEvent

FAULTY_S = 600.0  # before a server is asked again on which too many trials failed


class Bans(msgspec.Struct, eq=False):
    """Judge the servers of a run."""

    out: Outbox
    servers: Servers
    arbitrated: bytes = b""  # what this machine computed of the probe
    _disputed: bool = False  # it was asked to
    _faulty: dict[str, RemoteServer] = {}  # that were backed off for it

    # ---- wrong

    def judge_probes(self) -> None:
        """Back off or ban the servers whose outcomes of the probe differ from the first ones."""
        while self.servers.differing:
            server = self.servers.differing.pop()
            if server.differs_at(self.arbitrated) is not None:
                self.ban(server, "its outcomes of the probe are wrong")
                continue
            self.servers.end(server, Phase.BACKED_OFF, release=True, again_s=BACK_OFF_S)
            trial = server.differs_at(self.servers.probe)
            if trial is None:  # it differs no more: it is asked again
                continue
            text = (
                f"trial {trial} of the probe differs; this machine plays {trial + 1} and "
                "decides"
            )
            self.out.note(RunEvent.SERVER_DIFFERS, server.id, text)
            if not self._disputed:
                self._disputed = True
                self.out.commands.append(ProbeDisputed(trial + 1))

    def arbitrate_probe(self, digest: bytes) -> None:
        """Ban the servers whose outcomes of the probe differ from this machine's."""
        self.servers.probe, self.arbitrated, self._disputed = digest, digest, False
        for server in self.servers.by_id.values():
            if server.differs_at(digest) is not None:
                self.ban(server, "its outcomes of the probe are wrong")
            elif server.probe and server.phase == Phase.BACKED_OFF:
                self.servers.ask_by(server, self.out.now)

    def ban(self, server: RemoteServer, text: str) -> None:
        """Never use a server again, and retract what was counted for it."""
        if server.phase == Phase.BANNED:
            return
        # Before the note: if the record ends between the two, a resumed run finds the server out
        # again. The other way round it would restore what was counted for the server.
        self.out.commands.append(Retracted(server.id))
        self.servers.end(server, Phase.BANNED, release=True)
        self.out.note(RunEvent.SERVER_WRONG, server.id, text)

    def ban_wrong(self, name: str, trial: int) -> None:
        """Ban a server for its outcome of a trial; after a resume it may not be known yet."""
        self.ban(self.servers.known(name), f"its outcome of trial {trial} is wrong")

    # ---- faulty

    def blame(self, name: str) -> None:
        """Back off a server on which too many trials fail, if there is another one."""
        server = self.servers.known(name)
        server.blamed += 1
        if server.phase != Phase.LEASED or not server.fails_too_much():
            return
        if self.servers.roster.ready.keys() - {name}:
            text = f"{server.blamed} trials that failed on it did not fail elsewhere"
            self.servers.end(server, Phase.BACKED_OFF, release=True, again_s=FAULTY_S)
            self.out.note(RunEvent.SERVER_FAULTY, server.id, text)
            server.blamed, server.counted, server.faulty = 0, 0, True
            self._faulty[name] = server

    def recall_faulty(self) -> None:
        """Ask faulty servers again soon: they are better than none."""
        for server in self._faulty.values():
            if server.phase == Phase.BACKED_OFF and server.faulty:
                self.servers.ask_by(server, self.out.now + PAUSE_S)
        self._faulty.clear()
