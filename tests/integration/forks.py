"""Run optimizers in processes forked from one that has imported everything.

``Forks`` starts the program, which is this file, and has it play; each run is one process with a
record and a session of its own.
"""

import gc
import json
import os
import signal
import subprocess
import sys
import traceback
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from tests.integration.programs import wait_until

KILLED_IN = 1  # the generation in which processes kill themselves


class Forks:
    """Processes that play in a folder, one after another."""

    def __init__(self, folder: Path) -> None:
        self._errors = folder / "forks.err"
        with self._errors.open("wb") as errors:
            self._program = subprocess.Popen(
                [sys.executable, __file__],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
                cwd=folder,
                text=True,
                # Compiling would not pay off here; ribs would compile for seconds.
                env=os.environ | {"ZSWARM_PLAIN": "1", "NUMBA_DISABLE_JIT": "1"},
            )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._program.communicate()  # the end of its input ends it

    def run(
        self,
        experiment: dict[str, Any],
        out: Path,
        servers: Sequence[str],
        *,
        killed: bool = False,
    ) -> None:
        """Evolve on these servers only, to the end or until SIGKILL in generation ``KILLED_IN``."""
        task = {
            "experiment": experiment,
            "out": str(out),
            "servers": servers,
            "killed": killed,
        }
        self._play(task, -signal.SIGKILL if killed else 0)

    def resume(self, run: Path, servers: Sequence[str]) -> None:
        """Resume a run to its end."""
        self._play({"resume": str(run), "servers": servers}, 0)

    def _play(self, task: dict[str, Any], expected: int) -> None:
        stdin, stdout = self._program.stdin, self._program.stdout
        assert stdin
        assert stdout
        stdin.write(json.dumps(task) + "\n")
        stdin.flush()
        status = stdout.readline().strip()
        assert status == str(expected), (
            f"exit status {status} of {task}\n{self._errors.read_text()}"
        )


# ---- the program -------------------------------------------------------------------------------


def main() -> None:
    """Fork for each line of the input; answer with the exit status."""
    import_everything()
    gc.freeze()  # a forked process that looked through all this would copy every page of it
    for line in sys.stdin:
        child = os.fork()
        if not child:
            status = 1
            try:
                play(json.loads(line))
                status = 0
            except BaseException:
                traceback.print_exc()
            finally:
                sys.stderr.flush()
                os._exit(status)
        sys.stdout.write(f"{os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])}\n")
        sys.stdout.flush()


def import_everything() -> None:
    """Import what a run needs, and hash all parts: each forked process would do so again.

    No session is opened here: a process with one cannot be forked.
    """
    import cmaes  # noqa: F401
    import ribs.archives
    import ribs.emitters

    import zswarm.api
    import zswarm.ot.embedding  # noqa: F401
    from zswarm.plugins import registry as plugins
    from zswarm.plugins.version_hash import version_hash, versions

    for kind, table in plugins.BUNDLED.items():
        for name in table:
            plugins.load(kind, name)
    for simulator in plugins.BUNDLED["simulator"]:
        for representation in plugins.BUNDLED["representation"]:
            version_hash(simulator, representation)
            versions(simulator, representation)
    archive = ribs.archives.GridArchive(solution_dim=2, dims=[2], ranges=[(0, 1)])
    emitter = ribs.emitters.EvolutionStrategyEmitter(
        archive, x0=[0.0, 0.0], sigma0=1.0, batch_size=4
    )
    fitness, measures = [0.0] * 4, [[0.0]] * 4
    solutions = emitter.ask()
    emitter.tell(solutions, fitness, measures, archive.add(solutions, fitness, measures))


def play(task: dict[str, Any]) -> None:
    """Run or resume, in a forked process."""
    import zswarm
    from zswarm.ot.cluster import connection as connections

    class Killer(zswarm.Logger):
        """Kill its own process at the second progress message of a generation."""

        messages = 2

        def on_progress(self, generation: int, counted: int, trials: int) -> None:  # noqa: ARG002  an override
            self.messages -= generation == KILLED_IN
            if not self.messages:
                os.kill(os.getpid(), signal.SIGKILL)

    servers = task["servers"]
    connections.WAIT_FOR_SERVERS_S = 120.0  # other tests compute next to this
    with zswarm.connect(len(servers), connect=servers, multicast=False) as connection:
        if "resume" in task:
            with zswarm.resume(task["resume"], connection=connection) as resumed:
                resumed.finish()
            return
        loggers = [Killer()] if task["killed"] else []
        with zswarm.start(
            task["experiment"], out=task["out"], connection=connection, loggers=loggers
        ) as run:
            for generation in run:
                if task["killed"] and generation.generation == KILLED_IN:
                    # Results came in one message; the next generation is on its way.
                    os.kill(os.getpid(), signal.SIGKILL)
                if generation.generation == 0:
                    assert run.run, "waits until the generation is recorded"
                    wait_until(
                        lambda: connection.slots == len(servers), "all servers are ready"
                    )


if __name__ == "__main__":
    main()
