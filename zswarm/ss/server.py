"""The simulation server: a loop around the slot table. What other threads tell is only enqueued; the loop owns all state.

Life: start the workers, be on the network (``presence.py``), serve, drain.
"""

import contextlib
import math
import os
import platform
import secrets
import select
import signal
import sys
import time
from collections import deque
from collections.abc import Callable
from types import FrameType
from typing import TYPE_CHECKING

import msgspec
import structlog

import zswarm
from zswarm import notify, plugins
from zswarm.errors import ConfigError, RemoteProtocolError
from zswarm.extras import installing
from zswarm.protocol import codec, keys
from zswarm.protocol.messages import MAX_TEXT, Offer, Refused, Requirements, Reserve
from zswarm.security import keyring, refusals
from zswarm.session import Reach, keys_in_words
from zswarm.ss import asking, control, facts, limits, memory, orphans, slots, view
from zswarm.ss.options import AT_START, Options, offered
from zswarm.ss.presence import Presence, Question
from zswarm.ss.worker import SAID_WIDTH, Ready, Rest, Worker
from zswarm.version_hash import differing, lacking, version_hash, versions

if TYPE_CHECKING:
    from zswarm.ss.metrics import Metrics

TICK_S = 0.25
INBOX = 10_000  # queries that wait; more are dropped unanswered
RETURN_S = 5.0
MISSED_S = 30.0  # a slot's process that should be there for longer is named; sooner where systemd's watchdog is shorter
LOOK_EVERY_S, SHOW_EVERY_S = 0.1, 1.0  # at most; showing: to systemd and Prometheus

log = structlog.get_logger()


class Server:
    """One daemon."""

    def __init__(self, read_options: Callable[[], Options], *, until_stdin_closes: bool = False) -> None:
        """A server, not yet on the network.

        Args:
            read_options: called again for every reload.
            until_stdin_closes: it is another program's own, and ends with that.

        Raises:
            ConfigError: of the options or the keys.
        """
        self._read_options, self._private = read_options, until_stdin_closes
        self.options = options = read_options()
        self._reach = self._find_reach(options)
        capacity = options.capacity or os.cpu_count() or 1
        ring = self._reach.keyring
        self.id = keys.new_server_id(options.name or (ring.name if ring else keys.fold(platform.node())))
        self._presence = Presence(options.realm, self.id, self._on_network, private=self._private)
        self.simulators, self.representations = offered(options), plugins.names("representation")
        self.slot_memory_mb = options.slot_memory_mb or memory.per_slot_mb(capacity)
        self._facts = facts.facts(self.id.rpartition("-")[0], capacity, self.slot_memory_mb)
        self._limits = limits.read(options.limits, self.simulators, "limits")
        self.workers = [Worker(self.slot_memory_mb) for _ in range(capacity)]
        self.slots = slots.Slots(capacity, self._offer(), self._mismatch, lambda: secrets.token_bytes(16))
        self._asking = asking.Asking(self._ask, lambda slot, body: self.workers[slot].answer(body))
        orphans.adopt()
        self._start_workers()
        self._inbox: deque[Question | asking.Unheard | slots.Event] = deque()
        self._wake, self._woken = os.pipe()
        os.set_blocking(self._wake, False)
        os.set_blocking(self._woken, False)
        self._questions: dict[int, tuple[Question, str]] = {}  # with the run that asked
        self._signals: list[int] = []
        self._hashes = {
            (simulator, representation): version_hash(simulator, representation)
            for simulator in self.simulators
            for representation in self.representations
        }  # of the code as it is now, which the slots run; not of what an upgrade puts there later
        self._versions = {pair: versions(*pair) for pair in self._hashes}
        self._drain_by = float("inf")
        self._exit: int | None = None
        self._malformed = 0
        self._started_at, self._rate = time.time(), view.Rate(time.monotonic())
        self._notify = notify.Notify({} if self._private else os.environ)
        self._control: control.Control | None = None
        self._metrics: Metrics | None = None
        self._drain_asked = self._reload_asked = self._warm = False
        self._look_at = self._show_at = 0.0  # when next, by the monotonic clock
        self._return_at = math.inf  # to the network, which it lost in a reload
        self._left_behind, self._free = False, 0  # whether simulators may have left processes behind; slots that were free
        self._missed: dict[int, str] = {}  # slots whose process is missed, with the reason
        self._missed_s = min(MISSED_S, self._notify.watchdog_s)

    def run(self) -> int:
        """Serve until told to stop; the program's exit code."""
        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
            signal.signal(number, self._on_signal)
        signal.set_wakeup_fd(self._woken, warn_on_full_buffer=False)  # a signal just before the loop waits ends that wait, too
        with contextlib.ExitStack() as stack:
            stack.callback(self._close_workers)
            self._open_local(stack)
            if not self._private:
                refusals.watch_links()
            stack.callback(self._presence.close)
            self._presence.open(self.options.listen, self._reach)
            log.info(
                "server_ready", server=self.id, capacity=len(self.workers), realm=self.options.realm,
                listen=self._presence.endpoints, keys=keys_in_words(self._reach), simulators=self.simulators,
                slot_memory_mb=self.slot_memory_mb, program=zswarm.__version__,
            )  # fmt: skip
            self._loop()
            self._presence.finish(2.0)
        log.info("server_stopped", server=self.id)
        return self._exit or 0

    def _offer(self) -> Offer:
        capacity = len(self.workers)
        return Offer(
            server=self.id,
            program=zswarm.__version__,
            machine=f"{platform.system()} {platform.machine()}",
            capacity=capacity,
            free=capacity,
            leases=0,
            simulators=self.simulators,
            representations=self.representations,
            labels=self._facts | {name: str(value) for name, value in self.options.labels.items()},
            limits=[str(limit) for limit in self._limits],
        )

    def _find_reach(self, options: Options) -> Reach:
        """How it is reached by the options, with the keys that are installed now.

        Raises:
            ConfigError: the keys cannot be used, or are required and there are none.
        """
        if self._private:
            return Reach(options.connect, options.multicast)
        ring = keyring.installed("ss")
        if ring is None:
            if options.require_keys:
                raise ConfigError("require_keys is set, and no keys are installed: zswarm-keys join BUNDLE")
            return Reach(options.connect, options.multicast)
        if options.name not in ("", ring.name):
            raise ConfigError(f"name {options.name}: the keys in {ring.folder} are those of {ring.name}; leave the name away")
        return Reach(options.connect, options.multicast, keyring=ring)

    # ---- what other threads and the kernel tell

    def _on_network(self, item: Question | asking.Unheard | slots.Event) -> bool:
        if isinstance(item, Question) and len(self._inbox) >= INBOX:
            return False
        self._inbox.append(item)
        self._awake()
        return True

    def _on_signal(self, number: int, _frame: FrameType | None) -> None:
        if number == signal.SIGHUP:
            self._reload_asked = True
        else:
            self._signals.append(number)

    def _awake(self) -> None:
        with contextlib.suppress(BlockingIOError):
            os.write(self._woken, b"!")

    # ---- the loop

    def _loop(self) -> None:
        next_tick = time.monotonic()
        while self._exit is None:
            self._start_workers()
            workers = {worker.pipe.fileno(): index for index, worker in enumerate(self.workers) if worker.pipe is not None}
            poll = select.poll()
            leaving = {worker.leaving.sentinel: worker for worker in self.workers if worker.leaving is not None}
            saying = {worker.said.fileno(): index for index, worker in enumerate(self.workers) if worker.said is not None}
            for descriptor in (self._wake, *workers, *leaving, *saying):
                poll.register(descriptor, select.POLLIN)
            if self._private:
                poll.register(sys.stdin.fileno(), select.POLLIN)
            next_start = min(worker.start_at for worker in self.workers)
            until = min(next_start, self._look_at, self._return_at, self.slots.next_time(), self._asking.next_time())
            if self.slots.busy() or self.slots.draining or self._signals:
                until = min(until, next_tick)
            if self._control is not None:
                for descriptor, flags in self._control.wants().items():
                    poll.register(descriptor, flags)
                until = min(until, self._control.until())
            wait = None if math.isinf(until) else max(0.0, until - time.monotonic()) * 1000
            ready = [descriptor for descriptor, _ in poll.poll(wait)]
            if self._wake in ready:
                os.read(self._wake, 4096)
            if self._private and sys.stdin.fileno() in ready:
                self._exit = 0
            if self._control is not None:
                self._control.serve(ready)
            if self._signals or self._drain_asked:
                self._on_stop_asked()
            if self._reload_asked:
                self._reload()
            if time.monotonic() >= self._return_at:
                self._return()
            for descriptor in ready:
                if descriptor in leaving:
                    leaving[descriptor].look()
                    self._left_behind = True
                if descriptor in saying:
                    self._listen(saying[descriptor])
                if descriptor in workers and (event := self._from_worker(workers[descriptor])) is not None:
                    self._handle(event)
            for _ in range(len(self._inbox)):
                item = self._inbox.popleft()
                if isinstance(item, Question):
                    self._from_run(item)
                elif isinstance(item, asking.Unheard):
                    self._asking.unheard(item.question, time.monotonic())
                else:
                    self._handle(item)
                    if isinstance(item, slots.HolderGone):
                        self._presence.forget(f"{item.user}/{item.run}")
            if (now := time.monotonic()) >= min(next_tick, self.slots.next_time()):
                next_tick = now + TICK_S
                self._handle(slots.Tick(tuple(worker.trial() for worker in self.workers)))
            self._asking.ask_again(now)
            self._look(time.monotonic(), new=bool(ready))

    def _on_stop_asked(self) -> None:
        if self.slots.draining and (len(self._signals) > 1 or time.monotonic() > self._drain_by):
            log.warning("drain_cut_short", signals=len(self._signals))
            self._exit = self._code()
        elif not self.slots.draining:
            log.info("draining", limit_s=self.options.drain_s)
            self._notify.stopping()
            self._drain_by = time.monotonic() + self.options.drain_s
            self._presence.leave()
            self._handle(slots.Drain())

    def _code(self) -> int:
        return 128 + self._signals[0] if self._signals else 0

    def _reload(self) -> None:
        """Read keys and settings again, and be on the network anew; leases, batches and results live on."""
        self._reload_asked = False
        self._notify.reloading()
        try:
            options = self._read_options()
            reach = self._find_reach(options)
            new_limits = limits.read(options.limits, self.simulators, "limits")
            if (ring := reach.keyring) is not None and ring.name != self.id.rpartition("-")[0]:
                raise ConfigError(f"the keys are those of {ring.name}, this is {self.id}: start it again")
        except ConfigError as error:
            log.error("reload_refused", reason=str(error))
            self._reloaded()
            return
        if later := [name for name in AT_START if getattr(options, name) != getattr(self.options, name)]:
            log.warning("reload_later", settings=later, reason="these change when the server is started again")
        self._presence.close(or_exit=False)
        try:
            self._presence.open(options.listen, reach, seen=not self.slots.draining)
        except ConfigError as error:
            log.error("reload_refused", reason=str(error))
            self._return_at = time.monotonic()
        else:
            kept = {name: getattr(self.options, name) for name in AT_START}
            self.options, self._reach, self._return_at = msgspec.structs.replace(options, **kept), reach, math.inf
            self._limits = new_limits
            self.slots.offer = self._offer()
            log.info("reloaded", listen=self._presence.endpoints, keys=keys_in_words(reach))
        self._reloaded()

    def _reloaded(self) -> None:
        if self._warm and not self.slots.draining:
            self._notify.ready()

    def _return(self) -> None:
        """Be on the network as before the reload that was refused; until that can be, runs wait or go elsewhere."""
        try:
            self._presence.open(self.options.listen, self._reach, seen=not self.slots.draining)
            self._return_at = math.inf
        except ConfigError as error:
            log.error("off_the_network", reason=str(error), again_s=RETURN_S)
            self._return_at = time.monotonic() + RETURN_S

    def _from_run(self, question: Question) -> None:
        try:
            key, message = codec.decode_query(question.key, question.body)
        except RemoteProtocolError as error:
            self._log_malformed(question.key, error)
            self._presence.answer(question, "malformed", codec.encode(Refused(code="malformed", reason=str(error))))
            return
        self._questions[id(question)] = (question, f"{key.user}/{key.run}")
        self._handle(slots.Asked(id(question), key.user, key.run, message))

    def _start_workers(self) -> None:
        now = time.monotonic()
        for worker in self.workers:
            if worker.start_at <= now:
                worker.start()

    def _listen(self, slot: int) -> None:
        """Log what the simulator in a slot says."""
        worker = self.workers[slot]
        if worker.said is None:  # it was ended just before
            return
        held = self.slots.slots[slot]
        setup = held.lease.setup if held.lease is not None else held.setup
        simulator = setup.simulator.kind if setup is not None else ""
        for line in worker.listen():
            log.info("slot_said", slot=slot, simulator=simulator, text=codec.clean(line[:SAID_WIDTH]))

    def _end_left_behind(self) -> None:
        """End processes that simulators left behind: of slots whose process ended, and of those that no run holds."""
        for slot, worker in zip(self.slots.slots, self.workers, strict=True):
            if slot.state == slots.SlotState.FREE and worker.session and orphans.children(worker.session):
                log.info("slot_renewed", slot=slot.index, reason="processes of its simulator go on")
                worker.kill()
        rest = orphans.end({worker.session for worker in self.workers if worker.session})
        self._left_behind = bool(rest)

    def _from_worker(self, index: int) -> slots.Event | None:
        worker = self.workers[index]
        if worker.pipe is None:  # it was ended for what another one said just before
            return None
        self._listen(index)  # so that what it said before it answered is not taken for its last words
        try:
            letter, body = worker.receive()
        except (EOFError, OSError):
            self._asking.forget(index)
            trial, reason = worker.trial(), worker.exit_reason()
            self._log_pause(index, worker, reason)
            return slots.Died(index, trial, f"the slot's process {reason}")
        match letter:
            case b"H":
                return None
            case b"S":
                self._asked(index, body)
                return None
            case b"N":
                self._log_pause(index, worker, body.decode())
                return None
            case b"R":
                ready = msgspec.msgpack.decode(body, type=Ready)
                return slots.Prepared(index, ready.probe, ready.trial_s)
            case b"F":
                return slots.Unprepared(index, codec.clean(body.decode(errors="replace")))
            case b"X":
                rest = msgspec.msgpack.decode(body, type=Rest)
                return slots.Exhausted(index, rest.part, rest.done, rest.alone)
            case b"M":
                trial = worker.trial()
                worker.kill()
                return slots.Died(index, trial, body.decode(), "memory")
            case b"D":
                trial = worker.trial()
                worker.kill()
                return slots.Died(index, trial, codec.clean(body.decode(errors="replace")))
            case _:
                return slots.Finished(index, body, worn=letter == b"W")

    def _asked(self, slot: int, body: bytes) -> None:
        """A slot asks what controllers at the optimizer decide; where its batch is to end there is nobody to ask."""
        lease, worker = self.slots.slots[slot].lease, self.workers[slot]
        if lease is None or worker.stopping:
            worker.answer(asking.NOBODY)
        else:
            self._asking.ask(slot, (lease.user, lease.run), body)

    def _ask(self, run: tuple[str, str], question: int, body: bytes, at_once: bool) -> None:
        self._presence.ask(run, question, body, self._asking.answer, at_once=at_once)

    def _handle(self, event: slots.Event) -> None:
        self._left_behind |= isinstance(event, slots.Died)
        for command in self.slots.handle(event, time.monotonic()):
            match command:
                case slots.Answer():
                    self._presence.answer(*self._questions.pop(command.query), command.body)
                case slots.Prepare():
                    self._left_behind |= not command.known  # a process that had another problem is ended
                    self.workers[command.slot].prepare(command.setup, probe=command.probe, known=command.known)
                case slots.Run():
                    self.workers[command.slot].evaluate(command.body, command.first, command.alone, command.begin)
                case slots.Stop():
                    self.workers[command.slot].stop()
                    self._asking.stop(command.slot)
                case slots.Kill():
                    self._asking.forget(command.slot)
                    self._left_behind = True
                    self.workers[command.slot].kill()
                case slots.Log():
                    log.info(command.event, **command.fields)
                case slots.Drained():
                    self._exit = self._code()

    # ---- what it shows of itself on this machine

    def _open_local(self, stack: contextlib.ExitStack) -> None:
        """The control socket, and the port for Prometheus.

        Raises:
            ConfigError: the port cannot be had.
        """
        if self.options.metrics:
            from zswarm.ss.metrics import Metrics

            self._metrics = Metrics(self.options.metrics, self._view(time.monotonic()))
            stack.callback(self._metrics.close)
        if not self._private:
            try:
                self._control = control.Control(self.id, self._on_question)
                stack.callback(self._control.close)
            except OSError as error:
                log.warning("control_unavailable", path=str(error.filename), reason=error.strerror)

    def _on_question(self, question: control.Question) -> msgspec.Struct:
        if question.ask == "status":
            return self._view(time.monotonic())
        self._drain_asked = True
        return control.Draining(self.id)

    def _look(self, now: float, *, new: bool) -> None:
        """See to the watchdog, which is fed as long as this loop and all slots get on, and show what is new; not too often."""
        if new:
            self._look_at = min(self._look_at, now + LOOK_EVERY_S)
        if now < self._look_at:
            return
        if (free := self.slots.free()) > self._free or self._left_behind:
            self._end_left_behind()
        self._free = free
        self._name_missed(now)
        if not self._missed:
            self._notify.feed()
        if self.slots.draining:
            self._notify.extend()
        if not self._warm and all(worker.here or worker.pauses(now) for worker in self.workers):
            self._warm = any(worker.here for worker in self.workers)
            if self._warm:
                self._notify.ready()
        shown = self._view(now)
        lasts = bool(shown.trials_per_s or self.slots.draining or self._left_behind)
        if now >= self._show_at:
            self._show_at = now + SHOW_EVERY_S
            self._notify.status(shown.line())
            if self._metrics is not None:
                self._metrics.view = shown
        elif self._metrics is not None or self._notify.listens:
            lasts = True
        self._look_at = min(
            self._show_at if lasts else math.inf,
            math.inf if self._missed else self._notify.feed_at(),
            *(worker.missed_from(self._missed_s) for slot, worker in enumerate(self.workers) if slot not in self._missed),
        )

    def _name_missed(self, now: float) -> None:
        missed = {slot: reason for slot, worker in enumerate(self.workers) if (reason := worker.missed(now, self._missed_s))}
        if newly := missed.keys() - self._missed.keys():
            log.error(
                "slots_missed", slots=sorted(newly), reason=missed[min(newly)], seconds=round(self._missed_s, 1),
                watchdog="not fed" if math.isfinite(self._notify.watchdog_s) else "none",
            )  # fmt: skip
        if back := self._missed.keys() - missed.keys():
            log.info("slots_back", slots=sorted(back))
        self._missed = missed

    def _view(self, now: float) -> view.View:
        leases = self.slots.leases.values()
        return view.View(
            server=self.id,
            program=zswarm.__version__,
            pid=os.getpid(),
            realm=self.options.realm,
            listen=self._presence.endpoints,
            since=self._started_at,
            warm=self._warm,
            draining=self.slots.draining,
            slots=view.slot_states(self.slots, self.workers, now),
            leases=[
                view.LeaseView(
                    lease.user, lease.run, lease.setup.simulator.kind, len(lease.slots), lease.trials, now - lease.since
                )
                for lease in leases
            ],
            trials=self.slots.trials,
            trials_per_s=self._rate.take(self.slots.trials, now),
            busy_s=self.slots.seconds,
            faults=dict(self.slots.faults),
            malformed=self._malformed,
            waiting_batches=sum(len(lease.waiting) for lease in leases),
            waiting_queries=len(self._inbox),
            slot_memory_mb=self.slot_memory_mb,
            missed=[view.Missed(slot, reason) for slot, reason in self._missed.items()],
        )

    # ---- what it logs, what it refuses

    def _log_pause(self, slot: int, worker: Worker, reason: str) -> None:
        if (pause := worker.start_at - time.monotonic()) > 0:
            log.warning("slot_pauses", slot=slot, reason=reason, seconds=round(pause, 1))

    def _log_malformed(self, key: str, error: RemoteProtocolError) -> None:
        """The 1st, 2nd, 4th, 8th ... of them: a flood must not fill the disk."""
        self._malformed += 1
        if self._malformed & (self._malformed - 1) == 0:
            log.warning("malformed", key=codec.clean(key), reason=str(error), count=self._malformed)

    def _mismatch(self, asked: Requirements | Reserve) -> str:
        if isinstance(asked, Reserve):
            simulator, representation = asked.simulator.kind, asked.representation.kind
        else:
            simulator, representation = asked.simulator, asked.representation
        if not simulator and not representation:
            return ""
        if simulator not in self.simulators:
            return f"no simulator {simulator!r} here; there are {', '.join(self.simulators)}"[:MAX_TEXT]
        if (simulator, representation) not in self._hashes:
            return f"no representation {representation!r} here"
        if self._hashes[simulator, representation] != asked.version_hash:
            told, here = asked.versions if isinstance(asked, Requirements) else {}, self._versions[simulator, representation]
            if missing := lacking(here, told):
                return f"packages that {simulator!r} needs are not installed here: {installing(*missing)}"[:MAX_TEXT]
            if parts := differing(here, told):
                todo = "install the same, and start this server again"
                return f"another version is installed here: {'; '.join(parts)[: MAX_TEXT // 2]}; {todo}"
            return f"another version of {simulator}, {representation}, zswarm or numba is installed here"
        if asked.trial_memory_mb > self.slot_memory_mb:
            return f"a slot here has {self.slot_memory_mb} MB, the run asks for {asked.trial_memory_mb}"
        settings = asked.simulator.settings if isinstance(asked, Reserve) else asked.settings
        return limits.broken(self._limits, simulator, settings)

    def _close_workers(self) -> None:
        for worker in self.workers:
            worker.close()
        orphans.end(())
