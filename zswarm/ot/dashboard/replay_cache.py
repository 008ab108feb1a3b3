"""Compute replays for the page in another process, one at a time, within a time limit."""

import asyncio
import sys
from pathlib import Path

from zswarm.errors import ConfigError
from zswarm.system.processes import CODE
from zswarm.system.text import clean

LONGEST_S = 120.0  # the first replay of a simulator compiles it
LARGEST = 64 << 20  # bytes of one, and of all that are cached
PROGRAM = """
import sys
from pathlib import Path
from zswarm.errors import ZswarmError
from zswarm.ot.record.reader import Run
from zswarm.ot.replay.encoding import encode
from zswarm.ot.replay.trace import trace
try:
    numbers = [int(word) for word in sys.argv[2:]]
    sys.stdout.buffer.write(encode(trace(Run(Path(sys.argv[1])), *numbers)))
except ZswarmError as error:
    sys.exit(str(error))
"""


class ReplayCache:
    """The last encoded traces."""

    def __init__(self) -> None:
        # The last used one is last.
        self._traces: dict[tuple[Path, int, int, int], bytes] = {}
        self._lock = asyncio.Lock()

    async def get(
        self, folder: Path, generation: int, candidate: int, trial: int
    ) -> bytes:
        """Return a trace; raise ConfigError if it cannot be computed, or takes too long."""
        key = (folder, generation, candidate, trial)
        async with self._lock:
            found = self._traces.pop(key, None) or await _compute(*key)
            self._traces[key] = found
            while (
                sum(map(len, self._traces.values())) > LARGEST and len(self._traces) > 1
            ):
                del self._traces[next(iter(self._traces))]
            return found


async def _compute(folder: Path, *numbers: int) -> bytes:
    program = await asyncio.create_subprocess_exec(
        sys.executable,
        *CODE,
        PROGRAM,
        str(folder.resolve()),
        *map(str, numbers),
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
    )
    try:
        async with asyncio.timeout(LONGEST_S):
            encoded, errors = await program.communicate()
    except TimeoutError:
        raise ConfigError(
            f"the replay takes longer than {LONGEST_S:.0f} s: zswarm-ot replay has no such limit"
        ) from None
    finally:
        if program.returncode is None:
            program.kill()
            await program.communicate()  # reaps it
    if program.returncode:
        lines = errors.decode(errors="replace").strip().splitlines()
        raise ConfigError(
            clean(lines[-1] if lines else "the program that computes it ended")
        )
    if len(encoded) > LARGEST:
        raise ConfigError(
            f"the replay has {len(encoded):,} bytes, and {LARGEST:,} is the most that is shown here"
        )
    return encoded
