"""Log to stderr: for people on a terminal, otherwise one JSON object per line.

structlog is imported with the first line, because it loads asyncio: this machine's slots, which log
warnings only, start without it.
"""

import contextlib
import functools
import logging
import sys
from collections.abc import Iterator
from typing import Any

from zswarm.system import terminal

LEVELS = ("debug", "info", "warning", "error")
_level = "info"


def set_up(level: str = "info") -> None:
    """Choose the least level that is logged; call it once, when a program starts."""
    global _level  # a program has one log
    _level = level


def debug(event: str, /, **fields: Any) -> None:
    """Log what only those who look for a fault in zswarm need."""
    _log("debug", event, fields)


def info(event: str, /, **fields: Any) -> None:
    """Log what happens."""
    _log("info", event, fields)


def warning(event: str, /, **fields: Any) -> None:
    """Log what limits the program."""
    _log("warning", event, fields)


def error(event: str, /, **fields: Any) -> None:
    """Log what is broken."""
    _log("error", event, fields)


def _log(level: str, event: str, fields: dict[str, Any]) -> None:
    if LEVELS.index(level) >= LEVELS.index(_level):
        getattr(_logger(), level)(event, **fields)


@contextlib.contextmanager
def _without_rich() -> Iterator[None]:
    """Let modules find no rich while they are imported, unless it is there already.

    structlog takes five times as long to import with it, and would format tracebacks, which are
    text before structlog sees them.
    """
    if "rich" in sys.modules:
        yield
        return
    sys.modules["rich"] = None  # type: ignore[assignment]  # as where it is not installed
    try:
        yield
    finally:
        del sys.modules["rich"]


@functools.cache
def _logger() -> Any:
    with _without_rich():
        import structlog

    last: structlog.typing.Processor = structlog.processors.JSONRenderer()
    if sys.stderr.isatty():
        last = structlog.dev.ConsoleRenderer(colors=terminal.coloured(sys.stderr))
    structlog.configure(
        processors=[
            structlog.contextvars.merge_contextvars,
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso", utc=False),
            structlog.processors.format_exc_info,
            last,
        ],
        wrapper_class=structlog.make_filtering_bound_logger(
            getattr(logging, _level.upper())
        ),
        logger_factory=lambda *_: structlog.PrintLogger(sys.stderr),
    )
    return structlog.get_logger()
