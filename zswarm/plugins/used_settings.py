"""Which settings of a part have an effect, as its struct declares (``config.meta.only_with``)."""

from collections.abc import Mapping
from typing import Any

from zswarm.config import settings_docs
from zswarm.errors import UnknownPlugin
from zswarm.plugins.registry import Kind, load


def used_settings(kind: Kind, name: str, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings that have an effect in a part; all if it is not installed."""
    try:
        unused = settings_docs.unused(load(kind, name).settings_type, settings)
    except UnknownPlugin:
        unused = set()
    return {key: value for key, value in settings.items() if key not in unused}
