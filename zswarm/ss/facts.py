"""What a server knows of itself and states as labels, beside those that somebody gives it."""

import os
import platform
import re
from pathlib import Path

from zswarm.protocol.messages import LABEL_VALUE
from zswarm.ss import memory

CPUINFO = Path("/proc/cpuinfo")


def facts(name: str, slots: int, slot_memory_mb: int) -> dict[str, str]:
    """Labels by the names of ``options.FACTS``; what the system does not tell is left out.

    Args:
        name: of the server, as somebody calls it.
        slot_memory_mb: that a slot may take.
    """
    known = {
        "name": name,
        "os": platform.system().lower(),
        "machine": platform.machine(),
        "cpu": _cpu(),
        "cores": str(os.cpu_count() or ""),
        "memory_mb": str(memory.machine_mb()),
        "slots": str(slots),
        "slot_memory_mb": str(slot_memory_mb),
    }
    return {label: value for label, value in known.items() if re.fullmatch(LABEL_VALUE, value, re.ASCII)}


def _cpu() -> str:
    """The model of the first processor, as one word; "" where nobody tells."""
    try:
        with CPUINFO.open(errors="replace") as lines:
            model = next((line.partition(":")[2] for line in lines if line.startswith("model name")), "")
    except OSError:  # macOS
        return ""
    return re.sub(r"[^A-Za-z0-9_.:+-]+", "-", re.sub(r"\((R|TM)\)", "", model)).strip("-_.:+")[:63]
