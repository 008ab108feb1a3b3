"""Set up logging to stderr: for people on a terminal, otherwise one JSON object per line."""

import logging
import sys

import structlog

from zswarm.system import terminal

LEVELS = ("debug", "info", "warning", "error")


def set_up(level: str = "info") -> None:
    """Configure structlog; call it once, when a program starts."""
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
            getattr(logging, level.upper())
        ),
        logger_factory=structlog.PrintLoggerFactory(sys.stderr),
    )
