"""Simulate a link between a server and an optimizer, which breaks in the ways that links do."""

from typing import TYPE_CHECKING, Literal

from zswarm.ot.cluster.events import Answered, Gone, Seen
from zswarm.protocol import codec, messages
from zswarm.ss.slots import events

from .world import World

if TYPE_CHECKING:
    from .optimizer import Optimizer
    from .server import Server

QUERY_S = {
    "offer": 3.0,
    "reserve": 10.0,
    "renew": 25.0,
    "evaluate": 60.0,
    "cancel": 3.0,
    "release": 3.0,
}
SLOW_S = 8.0

# Queries end empty on a link that is down or mute, and by their timeout where it is deaf. The
# optimizer notices by the token that it is down, the server that it is down or deaf. A slow one is
# only slow.
State = Literal["up", "down", "mute", "deaf", "slow"]


class Link:
    """Carry messages between a server and an optimizer."""

    def __init__(self, world: World, server: "Server", optimizer: "Optimizer") -> None:
        self.world, self.server, self.optimizer = world, server, optimizer
        self.state: State = "up"
        self.breaks = 0  # messages in transit then are lost
        self.open: dict[int, str] = {}  # questions
        server.links[f"{optimizer.name} {optimizer.epoch}"] = self
        optimizer.links[server.id] = self
        self._meet()

    def _meet(self) -> None:
        """Let each side see the other's token."""
        if not self.server.slots.draining:
            self._travel(lambda: self.optimizer.handle(Seen(self.server.id)))
        self._travel(lambda: self._holder(alive=True))

    def _travel(self, call: "object") -> None:
        world, breaks = self.world, self.breaks

        def arrive() -> None:
            if breaks == self.breaks:
                call()  # type: ignore[operator]

        if self.state == "slow":
            world.at(SLOW_S * world.random.random(), arrive)
        else:
            world.soon(arrive)

    def set(self, state: State) -> None:
        """Break or restore the link; messages in transit are lost."""
        world = self.world
        if self.server.ended:
            state = "down"
        if state in ("up", "slow") and self.state in ("up", "slow"):
            self.state = state
            return
        world.tell(self.server.id, self.optimizer.name, "link is", state)
        self.state, self.breaks = state, self.breaks + 1
        if state in ("up", "slow"):
            if not self.optimizer.ended:
                self._meet()
            return
        if state in ("down", "deaf"):
            world.at(0.0, lambda: self._holder(alive=False))
        if state == "down":
            world.at(0.0, lambda: self.optimizer.handle(Gone(self.server.id)))
        if state in ("down", "mute"):
            delay = world.random.choice([0.001, 0.01, 5.0])
            for question in list(self.open):
                world.at(delay, lambda question=question: self._arrive(question, None))

    def _holder(self, *, alive: bool) -> None:
        optimizer = self.optimizer
        self.server.handle(events.HolderAlive(optimizer.user, optimizer.run, alive))

    def undeclare(self) -> None:
        """Undeclare the server's token."""
        self._travel(lambda: self.optimizer.handle(Gone(self.server.id)))

    def ask(self, question: int, message: messages.Request) -> None:
        """Send from the optimizer to the server."""
        world = self.world
        verb = messages.verb(message)
        if world.chance(world.failing):
            return  # it never ends, as if the link's own program had a bug
        self.open[question] = verb
        world.at(QUERY_S[verb], lambda: self._arrive(question, None))
        if self.state in ("down", "mute") or world.chance(world.failing):
            world.soon(lambda: self._arrive(question, None))
        elif self.state in ("up", "slow"):
            self._travel(lambda: self.server.receive(self, question, message))

    def answer(self, question: int, body: bytes) -> None:
        """Send from the server to the optimizer."""
        world = self.world
        reply: messages.Reply | str | None = codec.decode_reply(body)
        if world.chance(world.failing):
            reply = world.random.choice([None, "not a message"])
        if self.state in ("up", "slow"):
            self._travel(lambda: self._arrive(question, reply))
        if world.chance(world.failing):
            # Once more.
            world.at(
                1.0,
                lambda: self.optimizer.handle(
                    Answered(question, reply, self.server.machine)
                ),
            )

    def _arrive(self, question: int, reply: messages.Reply | str | None) -> None:
        if self.open.pop(question, None) is not None:
            self.optimizer.handle(Answered(question, reply, self.server.machine))
