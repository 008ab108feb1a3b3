"""How a run shows itself in a notebook: some lines that are updated in their place, without widgets."""

import time
from typing import Any

from zswarm.ot.display import summary
from zswarm.ot.logger import Generation, Logger, Result, Started
from zswarm.ot.terminal import plural

LINES = 6  # of what is said; older ones make room
UPDATE_S = 0.1  # between two updates


class NotebookDisplay(Logger):
    """Lines in a cell's output."""

    def __init__(self) -> None:
        self._handle: Any = None
        self._said: list[str] = []
        self._generations = 0
        self._line = ""
        self._updated = float("-inf")

    def on_start(self, run: Started) -> None:
        """See ``Logger``."""
        self._generations = run.experiment.generations

    def on_say(self, line: str) -> None:
        """See ``Logger``."""
        self._said = [*self._said, line][-LINES:]
        self._update()

    def on_generation(self, generation: Generation) -> None:
        """See ``Logger``."""
        g = generation
        self._line = (
            f"generation {g.generation + 1}/{self._generations}  best {g.best:.6g}  mean {g.mean:.6g}  "
            f"{plural(g.evaluations, 'evaluation')}  {plural(g.slots, 'slot')} on {plural(g.servers, 'server')}"
        )
        if time.monotonic() > self._updated + UPDATE_S:
            self._update()

    def on_end(self, result: Result | None) -> None:
        """See ``Logger``."""
        if result is not None:
            self._line = summary(result)
        self._update()

    def _update(self) -> None:
        from IPython.display import display

        shown = {"text/plain": "\n".join([*self._said, *([self._line] if self._line else [])])}
        if self._handle is None:
            self._handle = display(shown, raw=True, display_id=True)
        else:
            self._handle.update(shown, raw=True)
        self._updated = time.monotonic()
