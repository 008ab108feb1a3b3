"""Which servers have room while nothing waits that they should get, and when to look again."""

import math
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping

import msgspec

from zswarm.ot.cluster.remote_server import RemoteServer
from zswarm.ot.cluster.schedule import Schedule

# Until they are looked at again: so much of the time in which no server became idle, within these
# limits, and so long for each server of the run.
LOOK_SHARE, LOOK_S, LOOK_MOST_S, LOOK_SERVER_S = 0.05, 0.01, 1.0, 0.00005


class IdleServers(msgspec.Struct, eq=False):
    """The servers of a run that have room."""

    # Nothing waited that they may get.
    idle: OrderedDict[str, RemoteServer] = msgspec.field(default_factory=OrderedDict)
    spare: dict[str, RemoteServer] = {}  # others are expected to end sooner what waits
    moved: dict[str, RemoteServer] = {}  # they may serve now, or no more
    more: bool = False  # trials wait that idle servers have not seen
    looking: bool = False  # now
    look_at: float = math.inf
    _since: float = 0.0  # when a server became idle last

    def reset(self, serving: Mapping[str, RemoteServer]) -> None:
        """Let all that serve have room, and see what waits."""
        self.idle, self.spare, self.more = OrderedDict(serving), {}, True

    def follow(
        self,
        schedule: Schedule,
        serves: Callable[[RemoteServer], bool],
        answered: RemoteServer | None,
    ) -> list[RemoteServer]:
        """Have the schedule follow the servers that moved.

        Args:
            serves: returns whether a server can be given work.
            answered: a server that may have room again.

        Returns:
            The servers that may have room that they did not have before.
        """
        moved, self.moved = self.moved, {}
        room = []
        for server in moved.values():
            if serves(server):
                schedule.serve(server)
                room.append(server)
            elif schedule.leave(server):
                self.reset(schedule.serving)  # others get what it would have got
        if answered is not None and answered.id in schedule.serving:
            room.append(answered)
        for server in room:
            self.add(server, schedule.out.now)
        return room

    def add(self, server: RemoteServer, now: float) -> None:
        """Take note that a server may have room."""
        self.spare.pop(server.id, None)
        self.idle[server.id], self._since = server, now

    def full(self, server: RemoteServer) -> None:
        """Take note that a server has no room."""
        self.idle.pop(server.id, None)

    def spared(self, server: RemoteServer) -> None:
        """Leave what waits to others until the next look."""
        self.idle.pop(server.id, None)
        self.spare[server.id] = server

    def each(self, *, ranked: bool) -> Iterator[RemoteServer]:
        """Yield each server that is idle now, also if it is not any more when its turn comes.

        Args:
            ranked: those that rank first first; for this all are looked at.
        """
        self.more = False
        if ranked:
            yield from sorted(self.idle.values(), key=lambda server: server.place)
            return
        for _ in range(len(self.idle)):
            name, server = self.idle.popitem(last=False)
            self.idle[name] = server  # the next time, others come first
            yield server

    def all(self) -> list[RemoteServer]:
        """Return all servers that have room."""
        return [*self.idle.values(), *self.spare.values()]

    def next_time(self) -> float:
        """Return when they are to be looked at again."""
        return self.look_at

    def look(self, now: float) -> None:
        """Look again, if it is time."""
        if now >= self.look_at:
            self.look_at = math.inf
            self.idle |= self.spare
            self.spare = {}
            self.more = self.looking = True

    def look_later(self, now: float, servers: int) -> None:
        """Look again soon, if there is a server with room, and another one.

        Args:
            servers: of the run, all of which are looked at.
        """
        if servers > 1 and self.look_at == math.inf and (self.idle or self.spare):
            idle_s = min(LOOK_SHARE * (now - self._since), LOOK_MOST_S)
            self.look_at = now + max(LOOK_S, LOOK_SERVER_S * servers, idle_s)
