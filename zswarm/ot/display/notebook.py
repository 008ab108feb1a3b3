"""Show a run in a notebook: a few lines that are updated in place, without widgets."""

import time
from collections import deque
from typing import Any

from zswarm.ot.display.progress import PlainDisplay, progress, summary
from zswarm.ot.logger import Generation, Result

LINES = 6  # messages that are shown
UPDATE_S = 0.1  # between two updates


class NotebookDisplay(PlainDisplay):
    """Show the last messages and the progress as a cell's output."""

    def __init__(self) -> None:
        super().__init__()
        self._handle: Any = None
        self._messages: deque[str] = deque(maxlen=LINES)
        self._progress: list[str] = []
        self._updated = float("-inf")

    def on_say(self, line: str) -> None:
        self._messages.append(line)
        self._update()

    def on_wait(self, line: str) -> None:
        self._progress = [line]
        self._update()

    def on_generation(self, generation: Generation) -> None:
        self._progress = [progress(generation, self._generations)]
        if time.monotonic() > self._updated + UPDATE_S:
            self._update()

    def on_end(self, result: Result | None) -> None:
        if result is not None:
            self._progress = [summary(result)]
        self._update()

    def _update(self) -> None:
        from IPython.display import display

        shown = {"text/plain": "\n".join([*self._messages, *self._progress])}
        if self._handle is None:
            self._handle = display(shown, raw=True, display_id=True)
        else:
            self._handle.update(shown, raw=True)
        self._updated = time.monotonic()
