"""Logs go to stderr: for people on a terminal, one JSON object a line otherwise. Events are short nouns with fields."""

import logging
import sys

import structlog

from zswarm import screen

LEVELS = ("debug", "info", "warning", "error")


def set_up(level: str = "info") -> None:
    """Choose the form by where stderr goes; once, at a program's start."""
    if sys.stderr.isatty():
        last: structlog.typing.Processor = structlog.dev.ConsoleRenderer(colors=screen.coloured(sys.stderr))
    else:
        last = structlog.processors.JSONRenderer()
    structlog.configure(
        processors=[
            structlog.contextvars.merge_contextvars,
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso", utc=False),
            structlog.processors.format_exc_info,
            last,
        ],
        wrapper_class=structlog.make_filtering_bound_logger(getattr(logging, level.upper())),
        logger_factory=structlog.PrintLoggerFactory(sys.stderr),
    )
