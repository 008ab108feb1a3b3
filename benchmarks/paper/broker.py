"""The paper's network-based design: optimization tool and servers talk through MQTT.

The messages are the paper's seven, in its order, each with a server's id and a simulation's hash:
for every candidate discovery, server (from each idle one), parameters and control, then a sensor
message of each agent of a turn and an actuator message back, and fitness. The controllers are in
the one optimization tool. QoS 0: no message is acknowledged. Their encoding is msgpack, which costs
less than the text that the paper may have used.

As a program it is a server: ``python -m paper.broker PORT ID NODELAY``.
"""

import contextlib
import hashlib
import sys
import threading
from typing import Any, Self

import by_mqtt
import msgspec
import numpy as np

from zswarm.nets.representation import Representation
from zswarm.ot.problem import Problem
from zswarm.ot.workload import Workload
from zswarm.protocol.messages import Part
from zswarm.sims.simulator import Simulator, Turn

WAIT_S = 20.0  # without any message
START_S = 120.0  # of a server, which may compile first


class Message(msgspec.Struct, tag=True):
    """What each begins with."""

    server: str
    simulation: str


class Discovery(Message):
    """1: the wanted simulator and number of agents; sent to all servers, so ``server`` is empty."""

    simulator: str
    agents: int


class Server(Message):
    """2: a server that is idle and meets the requirements, and its abilities."""

    simulators: list[str]


class Parameters(Message):
    """3: the models' parameters and the environment's."""

    simulator: str
    settings: dict[str, Any]
    seed: int


class Control(Message):
    """4: start."""


class Sensor(Message):
    """5: readings of one agent, float32."""

    agent: int
    readings: bytes


class Actuator(Message):
    """6: commands for it, float32."""

    agent: int
    commands: bytes


class Fitness(Message):
    """7: the last one of a simulation."""

    fitness: float


TO_OPTIMIZER = ("server", "sensor", "fitness", "ready")
decode = msgspec.msgpack.Decoder(
    Discovery | Server | Parameters | Control | Sensor | Actuator | Fitness
).decode
encode = msgspec.msgpack.Encoder().encode


# ---- the optimization tool ---------------------------------------------------------------------


class Controllers:
    """Those of all agents of one simulation."""

    def __init__(
        self,
        number: int,
        parameters: np.ndarray,
        agents: int,
        representation: Representation,
    ) -> None:
        self.number = number  # of its trial
        self.server = ""  # until one is chosen
        self._parameters, self._step = parameters, representation.step
        self._states = np.zeros((agents, representation.state_size), np.float32)

    def act(self, agent: int, readings: bytes, outputs: int) -> bytes:
        """Take an agent's commands."""
        decided = np.empty(outputs, np.float32)
        self._step(
            self._parameters,
            self._states[agent],
            np.frombuffer(bytearray(readings), np.float32),
            decided,
        )
        return decided.tobytes()


class Broker(contextlib.AbstractContextManager["Broker"]):
    """Run a private mosquitto, the optimization tool's connection, and a process per server.

    Attributes:
        messages: that passed the optimization tool, both ways.
    """

    def __init__(self, *, nodelay: bool) -> None:
        self.nodelay, self.servers, self.messages = nodelay, 0, 0

    def __enter__(self) -> Self:
        with contextlib.ExitStack() as stack:
            self._port = by_mqtt.broker(stack, self.nodelay)
            self._client = by_mqtt.connected(self._port, self.nodelay)
            stack.callback(self._client.disconnect)
            self._ready, subscribed = threading.Semaphore(0), threading.Event()
            self._client.on_subscribe = lambda *_: subscribed.set()
            self._client.on_message = self._on_message
            self._client.subscribe([(topic, 0) for topic in TO_OPTIMIZER])
            self._client.loop_start()
            stack.callback(self._client.loop_stop)
            if not subscribed.wait(WAIT_S):
                raise TimeoutError("MQTT: the broker does not answer")
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def grow(self, servers: int, problem: Problem) -> None:
        """Start servers until there are enough, warmed up for a problem."""
        more = servers - self.servers
        for number in range(self.servers, servers):
            command = [
                sys.executable,
                "-m",
                "paper.broker",
                str(self._port),
                f"ss-{number}",
                str(int(self.nodelay)),
            ]
            by_mqtt.started(self._stack, command, stdin=_warming(problem))
        for _ in range(more):
            if not self._ready.acquire(timeout=START_S):
                raise TimeoutError("MQTT: a server did not start")
        self.servers = servers

    def play(self, problem: Problem, workload: Workload) -> None:
        """Simulate, one candidate per server at a time."""
        self._problem, self._workload = problem, workload
        parameters = problem.representation.parameters(workload.genomes)
        self._simulations = {
            self._hash(number): Controllers(
                number,
                parameters[workload.participants[number, 0]],
                len(problem.simulator.owners),
                problem.representation,
            )
            for number in range(len(workload.seeds))
        }
        self._waiting, self._used = iter(list(self._simulations)), set[str]()
        self._left, self._done = len(workload.seeds), threading.Event()
        for _ in range(self.servers):
            self._look()
        seen = -1
        while not self._done.wait(WAIT_S):
            if seen == self.messages:
                raise TimeoutError(f"MQTT: no message came for {WAIT_S:.0f} s")
            seen = self.messages

    def _hash(self, number: int) -> str:
        """Return a simulation's identifier: all that decides it, and its number."""
        problem, workload = self._problem.experiment.problem, self._workload
        genome = workload.genomes[workload.participants[number, 0]]
        said = msgspec.msgpack.encode(
            [problem.simulator, problem.settings, int(workload.seeds[number]), number]
        )
        return hashlib.blake2b(said + genome, digest_size=16).hexdigest()

    def _look(self) -> None:
        """Let the next candidate look for a server."""
        if simulation := next(self._waiting, ""):
            problem = self._problem
            wanted = Discovery(
                "",
                simulation,
                problem.experiment.problem.simulator,
                len(problem.simulator.owners),
            )
            self._publish("discovery", wanted)

    def _publish(self, topic: str, message: Message) -> None:
        self.messages += 1
        self._client.publish(topic, encode(message))

    def _on_message(self, _client: object, _data: object, received: Any) -> None:
        if received.topic == "ready":
            self._ready.release()
            return
        self.messages += 1
        message = decode(received.payload)
        controllers = self._simulations[message.simulation]
        match message:
            case Sensor():
                commands = controllers.act(
                    message.agent, message.readings, self._problem.simulator.outputs
                )
                self._publish(
                    f"{message.server}/actuator",
                    Actuator(message.server, message.simulation, message.agent, commands),
                )
            case Server() if not controllers.server and message.server not in self._used:
                controllers.server = message.server
                self._used.add(message.server)
                self._start(message.server, message.simulation, controllers.number)
            case Fitness():
                self._workload.fitness[controllers.number, 0] = message.fitness
                self._used.remove(message.server)
                self._left -= 1
                self._look()
                if not self._left:
                    self._done.set()

    def _start(self, server: str, simulation: str, number: int) -> None:
        problem = self._problem.experiment.problem
        self._publish(
            f"{server}/parameters",
            Parameters(
                server,
                simulation,
                problem.simulator,
                problem.settings,
                int(self._workload.seeds[number]),
            ),
        )
        self._publish(f"{server}/control", Control(server, simulation))


# ---- a simulation server -----------------------------------------------------------------------


class SimulationServer:
    """A simulator behind its wrapper, one simulation at a time."""

    def __init__(self, client: Any, name: str) -> None:
        self._client, self._name = client, name
        self._simulators: dict[bytes, Simulator] = {}
        self._simulation, self._busy = "", False

    def on_message(self, _client: object, _data: object, received: Any) -> None:
        """Answer the optimization tool."""
        match decode(received.payload):
            case Discovery(simulation=simulation, simulator="paced") if not self._busy:
                self._publish("server", Server(self._name, simulation, ["paced"]))
            case Parameters(
                simulation=simulation, simulator=simulator, settings=settings, seed=seed
            ):
                self._simulation, self._seed = simulation, seed
                self._simulator = self.built(simulator, settings)
            case Control(simulation=self._simulation):
                self._busy = True
                self._sense(self._simulator.reset(self._seed))
            case Actuator(simulation=self._simulation, agent=agent, commands=commands):
                self._actions[self._rows[agent]] = np.frombuffer(commands, np.float32)
                self._awaited -= 1
                if not self._awaited:
                    self._sense(self._simulator.step(self._actions))

    def built(self, simulator: str, settings: dict[str, Any]) -> Simulator:
        """Build a simulator with settings once."""
        from zswarm import evaluate

        key = msgspec.msgpack.encode([simulator, settings])
        if key not in self._simulators:
            self._simulators[key] = evaluate.build(
                simulator, settings, "fully-meshed", {}
            )[0]
        return self._simulators[key]

    def _sense(self, turn: Turn | None) -> None:
        """Send the sensors of all agents of a turn; at the end the fitness."""
        if turn is None:
            self._busy = False
            self._publish(
                "fitness",
                Fitness(
                    self._name,
                    self._simulation,
                    float(self._simulator.outcome().fitness[0]),
                ),
            )
            return
        self._rows = {agent: row for row, agent in enumerate(turn.agents)}
        self._actions = np.empty((len(turn.agents), self._simulator.outputs), np.float32)
        self._awaited = len(turn.agents)
        for agent, readings in zip(turn.agents, turn.observations, strict=True):
            self._publish(
                "sensor",
                Sensor(
                    self._name,
                    self._simulation,
                    int(agent),
                    readings.astype(np.float32).tobytes(),
                ),
            )

    def _publish(self, topic: str, message: Message) -> None:
        self._client.publish(topic, encode(message))


def _warming(problem: Problem) -> bytes:
    """Return a server's standard input: the problem to warm up for."""
    asked = problem.experiment.problem
    return msgspec.json.encode(Part(asked.simulator, {**asked.settings, "step_s": 0.0}))


def serve(port: int, name: str, nodelay: bool) -> None:
    """Serve simulations until ended."""
    client = by_mqtt.connected(port, nodelay)
    server = SimulationServer(client, name)
    part = msgspec.json.decode(sys.stdin.buffer.read(), type=Part)
    simulator = server.built(part.kind, part.settings)
    turn: Turn | None = simulator.reset(0)
    while turn is not None:
        turn = simulator.step(
            np.full((len(turn.agents), simulator.outputs), 0.5, np.float32)
        )
    client.on_message = server.on_message
    client.on_subscribe = lambda *_: client.publish("ready", b"")
    client.subscribe([("discovery", 0), (f"{name}/#", 0)])
    client.loop_forever()


if __name__ == "__main__":
    serve(int(sys.argv[1]), sys.argv[2], sys.argv[3] == "1")
