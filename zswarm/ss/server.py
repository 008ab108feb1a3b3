"""The simulation server: a loop around the slot table.

Other threads and signals only put items into the inbox; the loop owns all state. It ends when a
signal or the drain command asks it to, and everything that ran is finished.
"""

import contextlib
import functools
import math
import os
import platform
import secrets
import selectors
import signal
import sys
import time
from collections.abc import Callable

import msgspec

from zswarm import daemon
from zswarm.errors import ConfigError
from zswarm.protocol import codec, keys
from zswarm.protocol.messages import Sensors
from zswarm.security import keyring, refusals
from zswarm.session import Reach
from zswarm.ss.admission import Admission, read
from zswarm.ss.health import Health
from zswarm.ss.local.control import Control, Draining, LocalQuery, LocalRequest
from zswarm.ss.network import Inbox, Item, PeerQuery, Presence
from zswarm.ss.options import AT_START, Options, offered
from zswarm.ss.slots import events
from zswarm.ss.slots.table import SlotTable
from zswarm.ss.workers import memory, orphans
from zswarm.ss.workers.child import Here, SharedMemory
from zswarm.ss.workers.output import LINE_WIDTH
from zswarm.ss.workers.parent import Worker
from zswarm.ss.workers.remote import CANCELLED, FullPipe, Questions, Unheard
from zswarm.system import landlock, log
from zswarm.system.starting import Starting
from zswarm.system.systemd import Notify
from zswarm.system.text import clean
from zswarm.system.version import VERSION

TICK_S = 0.25
PASS_S = 0.1  # for the items of one pass of the loop
RETURN_S = 5.0  # to the network, which a reload lost
FINISH_S = 2.0  # for the last answers


class Server:
    """One daemon.

    Args:
        read_options: returns the options; called again for every reload.
        until_stdin_closes: it belongs to the program that started it, and ends with that.
    """

    def __init__(
        self, read_options: Callable[[], Options], *, until_stdin_closes: bool = False
    ) -> None:
        self._read_options, self._private = read_options, until_stdin_closes
        memory.check_machine()
        self.options = options = read_options()
        self._reach = self._find_reach(options)
        capacity = options.capacity or os.cpu_count() or 1
        ring = self._reach.keyring
        name = options.name or (ring.name if ring else keys.fold(platform.node()))
        self.id = keys.new_server_id(name)
        self._inbox = Inbox()
        self._presence = Presence(
            options.realm, self.id, self._inbox, private=self._private
        )
        self._selector = selectors.DefaultSelector()
        memory_mb = options.slot_memory_mb or memory.per_slot_mb(capacity)
        limits = read(options.limits, offered(options), "limits")
        self.workers = [
            Worker(slot, memory_mb, self._selector, self) for slot in range(capacity)
        ]
        orphans.adopt()
        self._start_workers()  # they load numba in parallel with what follows
        self._admission = Admission(offered(options), limits, memory_mb)
        offer = self._admission.offer(self.id, capacity, options.labels)
        new_token = functools.partial(secrets.token_bytes, 16)
        self.slots = SlotTable(capacity, offer, self._admission.mismatch, new_token)
        self._questions = Questions(
            self._presence.ask, lambda slot, body: self.workers[slot].answer(body)
        )
        notify = Notify({} if self._private else os.environ)
        self._health = Health(self.slots, self.workers, self._presence, notify)
        self._queries: dict[events.Query, PeerQuery] = {}
        self._signals: list[int] = []
        self._exit_code: int | None = None
        self._tick_at = 0.0
        self._drain_by = self._return_at = math.inf

    def run(self, starting: Starting | None = None) -> int:
        """Serve until a signal or the drain command; return the exit code.

        Args:
            starting: a mark that ends when the server can be reached.
        """
        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
            signal.signal(number, lambda number, _: self._inbox.put(number))
        # A signal just before the loop waits ends that wait, too.
        signal.set_wakeup_fd(self._inbox.woken, warn_on_full_buffer=False)
        with contextlib.ExitStack() as stack:
            stack.callback(self._close_workers)
            self._open_local(stack)
            if not self._private:
                refusals.watch_links()
                if reason := landlock.why_not(keyring.folders()):
                    log.warning(
                        "keys_not_hidden", reason=f"slots can read them: {reason}"
                    )
            stack.callback(self._presence.close)
            self._open(self.options, self._reach)
            if starting is not None:
                starting.end()
            log.info(
                "server_ready",
                server=self.id,
                capacity=len(self.workers),
                realm=self.options.realm,
                listen=self._presence.endpoints,
                keys=daemon.keys_in_words(self._reach),
                simulators=self._admission.simulators,
                slot_memory_mb=self.workers[0].memory_mb,
                program=VERSION,
            )
            self._loop()
            self._presence.finish(FINISH_S)
        log.info("server_stopped", server=self.id)
        return self._exit_code or 0

    def _find_reach(self, options: Options) -> Reach:
        """Return how the server is reached, with the keys that are installed now."""
        if self._private:
            return Reach(options.connect, options.multicast)
        reach = daemon.find_reach(
            "ss",
            options.connect,
            multicast=options.multicast,
            require_keys=options.require_keys,
        )
        if (ring := reach.keyring) is not None and options.name not in ("", ring.name):
            raise ConfigError(
                f"name {options.name}: the keys in {ring.folder} are those of {ring.name}; "
                "leave out the name"
            )
        return reach

    def _open(self, options: Options, reach: Reach) -> None:
        self._presence.open(options.listen, reach, visible=not self.slots.draining)

    def _open_local(self, stack: contextlib.ExitStack) -> None:
        """Open what this machine sees: the control socket, and the port for Prometheus."""
        if self.options.metrics:
            stack.callback(self._health.open_metrics(self.options.metrics).close)
        self._selector.register(self._inbox, selectors.EVENT_READ, self._inbox.clear_wake)
        if self._private:
            try:
                self._selector.register(sys.stdin, selectors.EVENT_READ, self._exit)
            except PermissionError:  # a file, which is at its end
                self._exit()
            return
        try:
            stack.callback(Control(self.id, self._inbox.put).close)
        except OSError as error:
            log.warning(
                "control_unavailable", path=str(error.filename), reason=error.strerror
            )

    def _close_workers(self) -> None:
        for worker in self.workers:
            worker.close()
        orphans.end_all()

    # ---- the loop

    def _loop(self) -> None:
        while self._exit_code is None:
            self._start_workers()
            ready = self._selector.select(self._timeout())
            for key, _ in ready:
                key.data()
            self._take_inbox()
            now = time.monotonic()
            if now >= self._drain_by:
                self._cut_drain_short()
            if now >= self._return_at:
                self._return()
            if now >= min(self._tick_at, self.slots.next_time()):
                self._tick_at = now + TICK_S
                self._handle(
                    events.Tick(tuple(worker.trial() for worker in self.workers))
                )
            self._questions.ask_again(now)
            self._health.look(time.monotonic(), new=bool(ready))

    def _timeout(self) -> float | None:
        if self._inbox:
            return 0.0
        until = min(
            self._drain_by,
            self._return_at,
            self._health.next_look,
            self._questions.next_time(),
            self.slots.next_time(),
            *(worker.start_at for worker in self.workers),
        )
        if self.slots.busy() or self.slots.draining:
            until = min(until, self._tick_at)
        return None if math.isinf(until) else max(0.0, until - time.monotonic())

    def _start_workers(self) -> None:
        now = time.monotonic()
        for worker in self.workers:
            if worker.start_at <= now:
                worker.start()

    def _take_inbox(self) -> None:
        """Take waiting items, for a while: the rest after slots and the watchdog had their turn."""
        until = time.monotonic() + PASS_S
        for item in self._inbox.take():
            self._take_item(item)
            if time.monotonic() >= until:
                return

    def _take_item(self, item: Item) -> None:
        match item:
            case PeerQuery():
                if (asked := self._presence.decode(item)) is not None:
                    self._queries[asked.query] = item
                    self._handle(asked)
            case LocalQuery(request, answer):
                if answer.set_running_or_notify_cancel():  # else its client is gone
                    answer.set_result(self._answer_local(request))
            case Unheard():
                self._questions.unheard(item.question, time.monotonic())
            case FullPipe():
                self.workers[item.slot].watch_pipe()
            case signal.SIGHUP:
                self._reload()
            case int():
                self._signals.append(item)
                self._drain()
            case _:
                self._handle(item)
                if isinstance(item, events.HolderAlive) and not item.alive:
                    self._presence.forget(f"{item.user}/{item.run}")

    def _handle(self, event: events.Event) -> None:
        """Give an event to the slot table, and carry out its commands."""
        for command in self.slots.handle(event, time.monotonic()):
            match command:
                case events.Answer():
                    self._presence.answer(self._queries.pop(command.query), command.body)
                case events.PrepareSlot():
                    self.workers[command.slot].prepare(command)
                case events.PlayProbe():
                    self.workers[command.slot].play_probe(command)
                case events.RunChunk():
                    self.workers[command.slot].run(command)
                case events.StopSlot():
                    self.workers[command.slot].stop()
                    self._questions.stop(command.slot)
                case events.KillSlot():
                    self._questions.forget(command.slot)
                    self.workers[command.slot].kill()
                case events.Log():
                    log.info(command.event, **command.fields)
                case events.Drained():
                    self._exit()

    # ---- slots

    def on_message(self, worker: Worker) -> None:
        """Take a message of a slot's process."""
        self.on_output(worker)  # first: what it wrote before its answer are no last words
        while (message := worker.receive()) is not None:
            match message:
                case Here() | SharedMemory():
                    pass
                case Sensors():
                    self._forward(worker, message)
                case _:
                    if isinstance(message, events.Died):
                        self._questions.forget(worker.slot)
                    self._handle(message)

    def on_output(self, worker: Worker) -> None:
        """Log what a simulator wrote."""
        slot = self.slots.slots[worker.slot]
        problem = slot.lease.reserve if slot.lease is not None else slot.prepared_for
        simulator = problem.simulator.kind if problem is not None else ""
        for line in worker.read_output():
            text = clean(line[:LINE_WIDTH])
            log.info("slot_said", slot=worker.slot, simulator=simulator, text=text)

    def on_exit(self, worker: Worker) -> None:  # noqa: ARG002  as Owner
        """Look for orphans of a process that ended."""
        self._health.expect_orphans()

    def on_full_pipe(self, worker: Worker) -> None:
        """Have the loop send on what a slot's process did not take."""
        self._inbox.put(FullPipe(worker.slot))

    def _forward(self, worker: Worker, sensors: Sensors) -> None:
        """Ask the optimizer for the actions of a slot's agents, unless the slot is to stop."""
        lease = self.slots.slots[worker.slot].lease
        if lease is None or worker.stopping:
            worker.answer(CANCELLED)
        else:
            self._questions.ask(
                worker.slot, (lease.user, lease.run), codec.encode(sensors)
            )

    # ---- end

    def _answer_local(self, request: LocalRequest) -> msgspec.Struct:
        if request.ask == "status":
            return self._health.view(time.monotonic())
        self._drain()
        return Draining(self.id)

    def _drain(self) -> None:
        """Finish what runs and exit; a second signal exits at once."""
        if self.slots.draining:
            if len(self._signals) > 1:
                self._cut_drain_short()
            return
        log.info("draining", limit_s=self.options.drain_s)
        self._health.notify.stopping()
        self._drain_by = time.monotonic() + self.options.drain_s
        self._presence.leave()
        self._handle(events.Drain())

    def _cut_drain_short(self) -> None:
        log.warning("drain_cut_short", signals=len(self._signals))
        self._exit()

    def _exit(self) -> None:
        self._exit_code = 128 + self._signals[0] if self._signals else 0

    # ---- reload

    def _reload(self) -> None:
        """Read keys and options again, and open the session again; leases and replies stay."""
        self._health.notify.reloading()
        try:
            options = self._read_options()
            reach = self._find_reach(options)
            limits = read(options.limits, self._admission.simulators, "limits")
            ring = reach.keyring
            if ring is not None and ring.name != self.id.rpartition("-")[0]:
                keys_of = f"the keys are those of {ring.name}, this is {self.id}"
                raise ConfigError(f"{keys_of}: start it again")
        except ConfigError as error:
            log.error("reload_refused", reason=str(error))
            self._health.ready()
            return
        at_start = {name: getattr(self.options, name) for name in AT_START}
        if later := [
            name for name, old in at_start.items() if getattr(options, name) != old
        ]:
            reason = "these change when the server is started again"
            log.warning("reload_later", settings=later, reason=reason)
        self._presence.close()
        try:
            self._open(options, reach)
        except ConfigError as error:
            log.error("reload_refused", reason=str(error))
            self._return_at = time.monotonic()
        else:
            self.options = options = msgspec.structs.replace(options, **at_start)
            self._reach, self._return_at = reach, math.inf
            self._admission.limits = limits
            self.slots.offer = self._admission.offer(
                self.id, len(self.workers), options.labels
            )
            log.info(
                "reloaded",
                listen=self._presence.endpoints,
                keys=daemon.keys_in_words(reach),
            )
        self._health.ready()

    def _return(self) -> None:
        """Open the session as before a refused reload; until then, runs wait or use others."""
        try:
            self._open(self.options, self._reach)
            self._return_at = math.inf
        except ConfigError as error:
            log.error("off_the_network", reason=str(error), again_s=RETURN_S)
            self._return_at = time.monotonic() + RETURN_S
