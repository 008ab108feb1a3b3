"""Replays for the page: computed by another program, which is ended when it takes too long, one at a time."""

import asyncio
import importlib.util
import os
import sys
from collections import OrderedDict
from pathlib import Path

from zswarm.errors import ConfigError
from zswarm.protocol.codec import clean

LONGEST_S = 120.0  # that computing one may take; the first one of a simulator compiles it
LARGEST = 64 << 20  # bytes of one, and of all that are kept
MODULE = "zswarm.ot.trace"
PROGRAM = """
import sys
from pathlib import Path
from zswarm.errors import ZswarmError
from zswarm.ot.reading import Run
from zswarm.ot.trace import trace
try:
    numbers = [int(word) for word in sys.argv[2:]]
    sys.stdout.buffer.write(trace(Run(Path(sys.argv[1])), *numbers).encode())
except ZswarmError as error:
    sys.exit(str(error))
"""

Key = tuple[Path, int, int, int]


class Traces:
    """Traces, and the last ones that were asked for."""

    def __init__(self) -> None:
        self._kept: OrderedDict[Key, bytes] = OrderedDict()
        self._one = asyncio.Lock()

    async def of(self, folder: Path, generation: int, candidate: int, trial: int) -> bytes:
        """One, encoded.

        Raises:
            ConfigError: it cannot be computed, or takes too long.
        """
        if importlib.util.find_spec(MODULE) is None:
            raise ConfigError("this zswarm has no replay")
        key = (folder, generation, candidate, trial)
        async with self._one:
            if key not in self._kept:
                self._kept[key] = await _computed(*key)
                while sum(map(len, self._kept.values())) > LARGEST and len(self._kept) > 1:
                    self._kept.popitem(last=False)
            self._kept.move_to_end(key)
            return self._kept[key]


async def _computed(folder: Path, *numbers: int) -> bytes:
    environment = {key: value for key, value in os.environ.items() if key != "ZSWARM_PLAIN"}  # it does evaluate
    program = await asyncio.create_subprocess_exec(
        sys.executable, "-c", PROGRAM, str(folder.resolve()), *map(str, numbers),
        env=environment, stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE,
    )  # fmt: skip
    try:
        async with asyncio.timeout(LONGEST_S):
            encoded, said = await program.communicate()
    except TimeoutError:
        raise ConfigError(f"the replay takes longer than {LONGEST_S:.0f} s: zswarm-ot replay has no such limit") from None
    finally:
        if program.returncode is None:
            program.kill()
            await program.communicate()  # to its end: it is no child any more then
    if program.returncode:
        last = said.decode(errors="replace").strip().splitlines()[-1:] or ["the program that computes it ended"]
        raise ConfigError(clean(last[0]))
    if len(encoded) > LARGEST:
        raise ConfigError(f"the replay has {len(encoded):,} bytes, and {LARGEST:,} is the most that is shown here")
    return encoded
