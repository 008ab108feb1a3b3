"""Machines that compute wrong outcomes are banned; those that fail too many are backed off."""

import msgspec

from zswarm.ot.cluster.events import Outbox, ProbeDisputed, Retracted
from zswarm.ot.cluster.remote_server import Phase, RemoteServer
from zswarm.ot.cluster.servers import BACK_OFF_S, PAUSE_S, Servers
from zswarm.ot.notes import RunEvent

FAULTY_S = 600.0  # before a server is asked again on which too many trials failed


class Bans(msgspec.Struct, eq=False):
    """Judge the servers of a run, by their machines."""

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
        self.out.note(RunEvent.PROBE_ARBITRATED, text=digest.hex())
        for server in list(self.servers.by_id.values()):
            if server.differs_at(digest) is not None:
                self.ban(server, "its outcomes of the probe are wrong")
            elif server.probe and server.phase == Phase.BACKED_OFF:
                self.servers.ask_by(server, self.out.now)

    def ban(self, server: RemoteServer, text: str) -> None:
        """Never use the machine of a server again, and retract what was counted for it."""
        machine, machines = server.machine, self.servers.machines
        if machine in machines.banned:
            return
        machines.banned[machine] = server.id
        of_machine = dict.fromkeys([server.id, *machines.servers(machine)])
        here = self.servers.by_id.values()
        of_machine |= dict.fromkeys(one.id for one in here if one.machine == machine)
        for name in of_machine:
            # Before the note: if the record ends between the two, a resumed run finds the machine
            # out again. The other way round it would restore what was counted for it.
            self.out.commands.append(Retracted(name))
            self.servers.end(self.servers.known(name), Phase.BANNED, release=True)
        self.out.note(RunEvent.SERVER_WRONG, server.id, text, machine=machine)

    def ban_wrong(self, name: str, trial: int) -> None:
        """Ban a server for its outcome of a trial; after a resume it may not be known yet."""
        self.ban(self.servers.known(name), f"its outcome of trial {trial} is wrong")

    # ---- faulty

    def blame(self, machine: str) -> None:
        """Back off a machine on which too many trials fail, if there is another one."""
        machines, ready = self.servers.machines, self.servers.roster.ready.values()
        machines.blamed[machine] += 1
        own = [server for server in ready if server.machine == machine]
        if not own or len(own) == len(ready) or not machines.fails_too_much(machine):
            return
        text = (
            f"{machines.blamed[machine]} trials failed on it, but not on other machines"
        )
        self.out.note(RunEvent.SERVER_FAULTY, own[0].id, text, machine=machine)
        machines.blamed[machine] = machines.counted[machine] = 0
        for server in own:
            self.servers.end(server, Phase.BACKED_OFF, release=True, again_s=FAULTY_S)
            server.faulty = True
            self._faulty[server.id] = server

    def recall_faulty(self) -> None:
        """Ask faulty servers again soon: they are better than none."""
        for server in self._faulty.values():
            if server.phase == Phase.BACKED_OFF and server.faulty:
                self.servers.ask_by(server, self.out.now + PAUSE_S)
        self._faulty.clear()
