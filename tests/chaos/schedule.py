"""Play one seeded schedule of programs and faults, and check what must hold at the end."""

import itertools
from functools import partial
from typing import NamedTuple

from .network import Link
from .optimizer import Optimizer
from .problem import Experiment, Trial
from .server import DEATHS, TRIALS_S, Server
from .world import BOUND_S, CALM_S, CHAOS_S, END_S, World

LINK_TIMEOUT_S = 8.0
STUCK_S = 1000.0  # in which a server of 40 trials is to send an outcome
LASTS_S = [0.1, 0.1, 3.0, 20.0, 70.0]  # faults
FAULTS = [
    *("down", "mute", "deaf", "slow"),  # a server's link
    *("crash", "drain", "worker", "worker", "freeze", "jump"),  # a server
    *("end", "takeover", "stop", "leap", "leave", "pause"),  # an optimizer
]
# Leases end by these.
ALONE_NEVER = {"crash", "drain", "end", "takeover", "jump", "leave", "pause"}
USERS = ["ada", "bob", "eve"]
OF_OPTIMIZERS = {"end", "takeover", "stop", "leap", "leave", "pause"}


class End(NamedTuple):
    """Describe the state after a schedule, on running servers."""

    world: World
    runs: list[str]
    done: list[str]
    # Hash by run, of those that no server could have lied to unnoticed.
    histories: dict[str, str]
    undisturbed: dict[str, str]  # what these should be
    slots_taken: int
    leases: int
    unanswered: int  # queries
    kept_bytes: int  # of answers


class Lab:
    """Simulate a world with servers and runs."""

    def __init__(self, seed: int) -> None:
        self.world = World(seed)
        draw = self.world.random
        self.servers: list[Server] = []
        self.optimizers: list[Optimizer] = []
        self._deaths: dict[Trial, int] = {}
        self._numbers = itertools.count()
        self._coming = 0  # runs
        self._trials_s, self._most = TRIALS_S, 3  # of a trial; slots of a server
        # One server that never ends, for one run: nothing is ever run twice.
        self.alone = draw.random() < 0.15
        # One server computes some trials wrong, and all are verified.
        self.liar = not self.alone and draw.random() < 0.15
        self.stuck = False
        if self.alone:
            self.add_server(sound=True).alone = True
            self._add_run("ada", "run-1")
            return
        if not self.liar and draw.random() < 0.25:
            self._crowd()
            return
        # One answers for ever that it computes.
        self.stuck = draw.random() < 0.3
        self.add_server(sound=self.liar)
        for _ in range(draw.randint(1 if self.liar else 0, 3)):
            self.world.at(draw.choice([0.0, 5.0]), self.add_server)
        if self.liar:
            self.add_liars()
        if self.stuck:
            self.add_server(sound=True, stuck=True)
        for run in ["run-1", "run-2", "run-3"][: draw.randint(1, 3)]:
            self._add_run(draw.choice(USERS), run)

    def _crowd(self) -> None:
        """Let users with several runs share few slots; they come one after the other."""
        draw = self.world.random
        tight = draw.random() < 0.5
        self._most, self._trials_s = (1, [1.0, 3.0]) if tight else (4, [0.2, 0.8])
        for _ in range(1 if tight else draw.randint(1, 2)):
            self.add_server(sound=True)
        for user in USERS[: draw.randint(2, 3)]:
            for number in range(1, draw.randint(1, 2 if tight else 3) + 1):
                self._coming += 1
                run = f"run-{number}"
                self.world.at(
                    draw.choice([0.0, 0.0, 20.0, 40.0]),
                    lambda user=user, run=run: self._add_run(user, run, busy=True),
                )

    def add_liars(self) -> None:
        """Start the servers of one machine, which tell the same lies."""
        for _ in range(self.world.random.choice([1, 2, 3])):
            self.add_server(sound=True, lies=0.3, machine="liar")

    def add_server(
        self,
        *,
        sound: bool = False,
        lies: float = 0.0,
        stuck: bool = False,
        machine: str = "",
    ) -> Server:
        """Start a server."""
        server = Server(
            self.world,
            next(self._numbers),
            self._deaths,
            sound=sound,
            lies=lies,
            stuck=stuck,
            trials_s=self._trials_s,
            most=self._most,
            machine=machine,
        )
        self.servers.append(server)
        for optimizer in self.optimizers:
            if not optimizer.ended:
                Link(self.world, server, optimizer)
        return server

    def _add_run(self, user: str, run: str, *, busy: bool = False) -> None:
        """Start a run; a busy one has much to evaluate, and breeds for long."""
        draw = self.world.random
        self._coming -= busy
        experiment = Experiment(
            run,
            draw.getrandbits(32),
            generations=draw.randint(1, 2 if busy else 3),
            population=8 if busy else draw.randint(2, 8),
            trials=draw.randint(1, 4 if busy else 5),
        )
        verify = 1.0 if self.liar else draw.choice([0.0, 0.0, 0.2])
        breeds_s = draw.choice([0.0, 0.0, 4.0, 15.0]) if busy else 0.0
        # A stuck server's trials are to come back also where none is started twice.
        twice = not (self.stuck and draw.random() < 0.7)
        self.add_optimizer(
            Optimizer(
                self.world,
                experiment,
                verify=verify,
                second_starts=twice,
                user=user,
                breeds_s=breeds_s,
            )
        )

    def add_optimizer(self, optimizer: Optimizer) -> None:
        """Start an optimizer."""
        self.optimizers.append(optimizer)
        for server in self.servers:
            if not server.ended:
                Link(self.world, server, optimizer)

    # ---- faults

    def fail_something(self) -> None:
        """Cause one fault, and schedule another."""
        world, draw = self.world, self.world.random
        if world.now > CHAOS_S:
            return
        world.at(draw.expovariate(0.3), self.fail_something)
        server = draw.choice(
            [server for server in self.servers if not server.ended] or self.servers
        )
        optimizers = [one for one in self.optimizers if not one.ended] or self.optimizers
        if not optimizers:
            return
        optimizer = draw.choice(optimizers)
        fault, lasts_s = draw.choice(FAULTS), draw.choice(LASTS_S)
        if self.alone and fault in ALONE_NEVER:
            return
        world.faults += 1
        world.tell(
            "FAULT", fault, server.id, optimizer.name, optimizer.epoch, f"{lasts_s} s"
        )
        if fault in OF_OPTIMIZERS:
            self._fail_optimizer(fault, optimizer, lasts_s)
        elif not server.ended:
            self._fail_server(fault, server, lasts_s)

    def _fail_server(self, fault: str, server: Server, lasts_s: float) -> None:
        world = self.world
        match fault:
            case "down" | "mute" | "deaf" | "slow":
                for link in list(server.links.values()):
                    link.set(fault)
                    world.at(lasts_s, lambda link=link: link.set("up"))
            case "crash":
                server.end()
                self._start_again(server)
            case "drain" if not server.slots.draining:
                server.drain()
            case "worker":
                self._kill_worker(server)
            case "freeze" if not server.frozen:
                self._freeze(server, list(server.links.values()), lasts_s)
            case "jump":
                server.offset += world.random.choice([1.0, 30.0, 3600.0])

    def _start_again(self, server: Server) -> None:
        """Start another server where one crashed: a liar's machine goes on lying."""
        again = self.add_server
        if server.lies:
            again = partial(again, sound=True, lies=server.lies, machine=server.machine)
        self.world.at(self.world.random.uniform(0.1, 5.0), again)

    def _kill_worker(self, server: Server) -> None:
        worker = self.world.random.choice(server.workers)
        trial = worker.progress()
        if worker.since is None or not worker.trials:
            return
        deaths = self._deaths.get(worker.trials[trial], 0)
        if deaths < DEATHS:
            self._deaths[worker.trials[trial]] = deaths + 1
            worker.die()

    def _fail_optimizer(self, fault: str, optimizer: Optimizer, lasts_s: float) -> None:
        world = self.world
        if optimizer.ended:
            return
        match fault:
            case "pause" if not optimizer.paused:
                optimizer.pause(lasts_s)
            case "end" | "leave" if not optimizer.superseded:
                optimizer.stop() if fault == "leave" else optimizer.end()
                world.at(
                    world.random.uniform(0.1, 40.0),
                    lambda: self.add_optimizer(optimizer.resume()),
                )
            case "takeover" if not optimizer.superseded:
                self.add_optimizer(optimizer.resume())
            case "stop" if not optimizer.frozen:
                self._freeze(optimizer, list(optimizer.links.values()), lasts_s)
            case "leap":
                optimizer.offset += world.random.choice([1.0, 30.0, 3600.0])

    def _freeze(
        self, node: Server | Optimizer, links: list[Link], lasts_s: float
    ) -> None:
        """Stop a program (SIGSTOP), resume it later; after the link timeout it counts as gone."""
        node.frozen = True
        if lasts_s > LINK_TIMEOUT_S:
            for link in links:
                self.world.at(LINK_TIMEOUT_S, lambda link=link: link.set("down"))

        def go_on() -> None:
            node.wake()
            for link in links:
                link.set("up")

        self.world.at(lasts_s, go_on)

    # ---- what must have come of it

    def play(self) -> None:
        """Play the schedule to its end.

        Raises:
            AssertionError: a rule was broken.
        """
        world = self.world
        world.at(1.0, self.fail_something)
        world.run(CALM_S, self._done)
        for link in [link for server in self.servers for link in server.links.values()]:
            link.set("up")
        if not any(server.good() for server in self.servers):
            self.add_server(sound=True)
        bound_s = BOUND_S + STUCK_S * self.stuck
        world.run(world.now + bound_s, self._done)
        standing = self._standing()
        undone = not all(optimizer.left for optimizer in standing)
        if undone and all(
            optimizer.progressed_at < world.now - bound_s for optimizer in standing
        ):
            world.fail("no run makes progress")
        for optimizer in self._standing():
            if (
                not optimizer.left
                and max(optimizer.progressed_at, optimizer.unserved_at)
                < world.now - bound_s
            ):
                world.fail(f"{optimizer.name} has slots and makes no progress")
        world.run(END_S, self._done)
        world.run(max(world.now, CALM_S) + 120.0)  # a frozen server frees nothing
        end = self.end()
        if end.done != end.runs:
            world.fail(f"of {end.runs} only {end.done} are done")
        if end.histories != end.undisturbed:
            world.fail(f"other histories than those of undisturbed runs: {end.histories}")
        if end.slots_taken or end.leases or end.unanswered or end.kept_bytes:
            world.fail(f"something leaks: {end[5:]}")

    def _standing(self) -> list[Optimizer]:
        return [optimizer for optimizer in self.optimizers if not optimizer.superseded]

    def _done(self) -> bool:
        return not self._coming and all(
            optimizer.left or (optimizer.superseded and optimizer.ended)
            for optimizer in self.optimizers
        )

    def end(self) -> End:
        """Return what the schedule left, once it is over."""
        trusted = [
            optimizer for optimizer in self._standing() if not optimizer.journal.doubtful
        ]
        up = [server for server in self.servers if not server.ended]
        return End(
            world=self.world,
            runs=sorted({optimizer.name for optimizer in self.optimizers}),
            done=sorted(
                optimizer.name for optimizer in self._standing() if optimizer.left
            ),
            histories={
                optimizer.name: optimizer.journal.history() for optimizer in trusted
            },
            undisturbed={
                optimizer.name: optimizer.experiment.undisturbed()
                for optimizer in trusted
            },
            slots_taken=sum(len(server.workers) - server.slots.free() for server in up),
            leases=sum(len(server.slots.leases) for server in up),
            unanswered=sum(len(server.pending) for server in up),
            kept_bytes=sum(server.slots.leases.replies.size for server in up),
        )


def play(seed: int) -> End:
    """Play the schedule of a seed.

    Raises:
        AssertionError: a rule was broken.
    """
    lab = Lab(seed)
    try:
        lab.play()
    except AssertionError:
        raise
    except Exception as error:
        lab.world.fail(repr(error))
    return lab.end()
