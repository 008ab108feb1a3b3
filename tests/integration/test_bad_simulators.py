"""One server, one run, and a simulator that does in each trial something else that it should not.

What the simulator's code decides is this trial's outcome; what ends its process is a fault, three
times, and then NaN. All that comes after is as if nothing had been.
"""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from tests.integration import programs
from tests.integration.programs import Optimizer, Server, query, status, wait_until

SHARED = Path("/dev/shm")  # noqa: S108  where the system has it
pytestmark = pytest.mark.programs

SOURCE = '''
import ctypes
import os
import resource
import signal
import socket
import subprocess
import sys
import threading
import time
from multiprocessing.shared_memory import SharedMemory
from pathlib import Path

import msgspec
import numpy as np

from zswarm.sims.simulator import Outcome, Simulator, Turn

print("a word of the module")


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    what: list[str]
    folder: str


class Bad(Simulator):
    """Observation: one half. Action: one number. Fitness: it. One agent, one turn."""

    settings_type = Settings
    metrics = ("seed",)
    inputs, outputs, owners = 1, 1, (0,)

    def __init__(self, settings):
        super().__init__(settings)
        print("a word of the constructor")
        os.system("echo a word of a program")

    def fixed_seeds(self, trials):
        return range(trials)

    def reset(self, seed):
        self.seed, self.observed, self.given = seed, np.full((1, 1), 0.5), None
        self.demand()
        if seed < len(self.settings.what):  # not in the trials of the probe
            self.given = getattr(self, self.settings.what[seed])()
        if self.given is self.nothing:
            return None
        return Turn((0,), self.observed)

    def step(self, actions):
        self.action = float(actions[0, 0])
        return None

    def outcome(self):
        if isinstance(self.given, Outcome):
            return self.given
        return Outcome([self.action], [self.seed])

    def nothing(self):
        return self.nothing_at_all

    def demand(self):
        """Fail in a process that an earlier trial spoiled."""
        opened = [os.open(os.devnull, os.O_RDONLY) for _ in range(100)]
        for file in opened:
            os.close(file)
        if max(opened) > 250 or "BAD" in os.environ or os.getcwd() == "/":
            raise RuntimeError("left open files, a variable, or another folder")
        if os.umask(os.umask(0)) == 0o123 or threading.active_count() > 1:
            raise RuntimeError("left a umask or a thread")
        if any(signal.getitimer(timer)[0] for timer in (0, 1, 2)):
            raise RuntimeError("left an alarm")
        if os.fstat(0) != os.stat(os.devnull):
            raise RuntimeError("stdin is a file")
        self.deep(500)

    def deep(self, levels):
        if levels:
            self.deep(levels - 1)

    # ---- the trial's outcome is NaN

    def wrong_shape(self):
        self.observed = np.zeros((1, 2))

    def nan_observation(self):
        self.observed = np.full((1, 1), np.nan)

    def nan_fitness(self):
        return Outcome([np.nan], [0.0])

    def infinite_fitness(self):
        return Outcome([-np.inf], [0.0])

    def too_many_metrics(self):
        return Outcome([1.0], [0.0, 0.0])

    def sys_exit(self):
        sys.exit(3)

    def keyboard_interrupt(self):
        raise KeyboardInterrupt

    def recursion(self):
        self.recursion()

    def base_exception(self):
        raise type("Odd", (BaseException,), {})("odd")

    # ---- nothing comes of it

    def fine(self):
        pass

    def changes_directory(self):
        os.chdir("/")

    def changes_signals(self):
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGCHLD):
            signal.signal(number, lambda *_: None)

    def prints(self):
        for number in range(20_000):
            print("word", number)
            print("wrong", number, file=sys.stderr)

    def closes_stdout(self):
        os.close(1)
        os.close(2)
        os.open(os.devnull, os.O_WRONLY)  # what is opened next gets its number
        os.open(os.devnull, os.O_WRONLY)

    def starts_a_thread(self):
        threading.Thread(target=time.sleep, args=(3600,), daemon=True).start()

    def note(self, process):
        with open(Path(self.settings.folder) / "left", "a") as left:
            left.write(f"{process}\\n")

    def starts_alarms(self):
        signal.alarm(3600)

    def lowers_limits(self):
        resource.setrlimit(resource.RLIMIT_NOFILE, (30, 30))

    def lowers_recursion(self):
        sys.setrecursionlimit(200)

    def changes_the_world(self):
        os.environ["BAD"] = "1"
        os.umask(0o123)

    def leaves_files(self):
        for _ in range(300):
            os.dup(0)

    def leaves_shared_memory(self):
        memory = SharedMemory(create=True, size=4096)
        with open(Path(self.settings.folder) / "shared", "a") as shared:
            shared.write(f"{memory.name}\\n")
        memory.close()

    def closes_files(self):
        os.closerange(3, 1000)

    def leaves_a_program(self):
        self.note(subprocess.Popen(["sleep", "3600"]).pid)

    def leaves_a_daemon(self):
        if (child := os.fork()) == 0:
            os.setsid()
            if (grandchild := os.fork()) == 0:
                time.sleep(3600)
            self.note(grandchild)
            os._exit(0)
        os.waitpid(child, 0)

    def forks(self):
        self.note(os.fork() or os.getpid())

    # ---- faults

    def exits(self):
        print("last words")
        os._exit(7)

    def crashes(self):
        ctypes.string_at(0)

    def hangs(self):
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        time.sleep(3600)

    def kills_all(self):
        os.kill(0, signal.SIGKILL)

    def closes_everything(self):
        os.closerange(3, 1 << 20)

    def writes_everywhere(self):
        for number in map(int, os.listdir("/proc/self/fd")):
            if number > 2:
                try:
                    socket.socket(fileno=os.dup(number)).send(b"stray")
                except OSError:
                    pass
        time.sleep(3600)
'''
EXPERIMENT = """
name = "bad"
seed = 1
generations = 1
[problem]
simulator = "bad"
trials = {trials}
[problem.settings]
what = {what}
folder = "{folder}"
[representation]
kind = "fully-meshed"
[optimizer]
kind = "random"
population = 2
[cluster]
trial_timeout_s = 3.0
on_fault = "quarantine"
"""
NAN = [
    *(
        "wrong_shape",
        "nan_observation",
        "nan_fitness",
        "infinite_fitness",
        "too_many_metrics",
        "sys_exit",
        "keyboard_interrupt",
    ),
    *("recursion", "base_exception", "nothing"),
]
SPOILS = {  # what is said of it
    "starts_alarms": "a timer or an alarm set",
    "lowers_limits": "the limit NOFILE changed to 30",
    "lowers_recursion": "the recursion limit changed to 200",
    "changes_the_world": "the environment variable BAD changed",
    "leaves_files": "a file open (/dev/null)",
    "leaves_shared_memory": "shared memory (/psm_",
    "closes_files": "files closed that it did not open",
}
SPOILED = {
    **SPOILS,
    "changes_directory": "the working folder changed to /",
    "changes_signals": "the handling of SIGINT changed",
    "closes_stdout": "another standard stream",
    "starts_a_thread": "1 thread running",
}
HARMLESS = [
    *(
        "fine",
        "changes_directory",
        "changes_signals",
        "prints",
        "closes_stdout",
        "starts_a_thread",
        "leaves_a_program",
    ),
    *("leaves_a_daemon", "forks"),
    *SPOILS,
]
FAULTS = {
    "exits": "crashed: simulator bad: the slot's process ended with code 7; it wrote: last words",
    "crashes": "crashed: simulator bad: the slot's process was killed by signal 11 (SIGSEGV); "
    "it wrote: Fatal Python error: "
    "Segmentation fault, File ",
    "hangs": "timeout: simulator bad: one trial took longer than 3 s (cluster.trial_timeout_s)",
    "kills_all": "crashed: simulator bad: the slot's process was killed by signal 9",
    "closes_everything": "crashed: simulator bad: the slot's process closed its pipe",
    "writes_everywhere": "crashed: simulator bad: the simulator wrote into the pipe of its process:"
    " b'stray'... is not the beginning of a message",
}
# After each that may spoil its process there is one that demands a clean one.
WHAT = [
    *(name for pair in zip(NAN, HARMLESS, strict=False) for name in pair),
    *(name for harmless in HARMLESS[len(NAN) :] for name in (harmless, "fine")),
    *FAULTS,
    "nothing",
    "fine",
]


def test_a_misbehaving_simulator_affects_only_its_own_trials(tmp_path: Path) -> None:
    site = tmp_path / "site"
    site.mkdir()
    installed = programs.install(site, "zswarm_bad", SOURCE, "bad = zswarm_bad:Bad")
    experiment = tmp_path / "bad.toml"
    experiment.write_text(
        EXPERIMENT.format(trials=len(WHAT), what=json.dumps(WHAT), folder=tmp_path)
    )
    environment = {"PYTHONPATH": installed, "ZSWARM_PLAIN": "1"}
    server = Server(tmp_path, "ss", **environment).ready()
    try:
        options = [
            "--json",
            "--no-multicast",
            "--servers",
            "1",
            "--connect",
            server.endpoint,
        ]
        optimizer = Optimizer(
            tmp_path, "ot", ["run", str(experiment), *options], **environment
        )
        done = optimizer.done()
        check_outcomes(tmp_path / "runs" / "bad")
        assert done["faulted"] % len(FAULTS) == 0
        assert len(optimizer.lines()) == len(optimizer.out.read_text().splitlines()), (
            "JSON alone"
        )
        assert re.findall("^a word of .*", optimizer.err.read_text(), re.M) == [
            *("a word of the module", "a word of the constructor", "a word of a program"),
        ]
        assert wait_until_ended(tmp_path / "left") >= 4
        shared = (tmp_path / "shared").read_text().split()
        assert shared
        there = {path.name for path in SHARED.iterdir()}
        assert not there & set(shared)
        assert server.out.read_text() == ""
        for line in server.err.read_text().splitlines():
            json.loads(line)
        said = server.events("slot_said")
        assert {"bad"} == {
            event["simulator"]
            for event in said
            if event["text"] == "a word of the module"
        }
        assert len(said) <= 21 * (2 + 3 * done["faulted"]), "not the forty thousand lines"
    finally:
        server.close()


def test_a_slot_prepares_again_if_its_process_was_replaced_between_two_runs(
    tmp_path: Path,
) -> None:
    installed = programs.install(tmp_path, "zswarm_bad", SOURCE, "bad = zswarm_bad:Bad")
    experiment = tmp_path / "bad.toml"
    what = json.dumps(["leaves_a_program"])
    experiment.write_text(EXPERIMENT.format(trials=1, what=what, folder=tmp_path))
    environment = {"PYTHONPATH": installed, "ZSWARM_PLAIN": "1"}
    server = Server(tmp_path, "ss", capacity=1, **environment).ready()
    options = ["--json", "--no-multicast", "--servers=1", f"--connect={server.endpoint}"]
    try:
        for replaced in (1, 2):
            run = ["run", str(experiment), *options]
            done = Optimizer(tmp_path, f"ot-{replaced}", run, **environment).done()
            assert done["faulted"] == 0
            wait_until(
                lambda: len(server.events("slot_renewed")) >= replaced,  # noqa: B023
                "the process that left a program behind is replaced",
            )
        assert server.events("slot_died") == []
        assert wait_until_ended(tmp_path / "left") >= 2
    finally:
        server.close()


def wait_until_ended(file: Path) -> int:
    """Wait until the programs that a file lists have ended; return how many it lists."""
    left = [int(process) for process in file.read_text().split()]
    wait_until(lambda: not any(map(status, left)), "what was left behind is gone")
    return len(left)


def check_outcomes(run: Path) -> None:
    (asked,) = query(run, "SELECT sum(count) FROM outcomes")[0]
    fitness = np.full(asked, np.inf)
    for trials, values in query(run, "SELECT trials, fitness FROM outcomes"):
        fitness[np.frombuffer(trials, "<u4")] = np.frombuffer(values, "<f8")
    for candidate in fitness.reshape(-1, len(WHAT)):
        for what, value in zip(WHAT, candidate, strict=True):
            if what in HARMLESS:
                assert value == candidate[WHAT.index("fine")], what
            else:
                assert np.isnan(value), what
    told = [
        text for (text,) in query(run, "SELECT text FROM events WHERE event = 'fault'")
    ]
    for what, words in FAULTS.items():
        mine = [text for text in told if f"its seed {WHAT.index(what)}, " in text]
        assert len(mine) == 3 * len(fitness) // len(WHAT), (what, told)
        said = words.partition("; it wrote")[0]
        assert all(said in text for text in mine), mine
        # An earlier trial may have closed stderr.
        assert any(words in text for text in mine), (words, mine)
    left = query(run, "SELECT text FROM events WHERE event = 'simulator_left'")
    for what, words in SPOILED.items():
        assert any(words in text for (text,) in left), (what, left)
    raised = query(run, "SELECT text FROM events WHERE event = 'simulator_raised'")
    assert all(re.search(r"Bad, trial seed \d+: ", text) for (text,) in raised), raised
