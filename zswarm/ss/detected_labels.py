"""Labels that a server detects by itself, in addition to those that a user gives it."""

import os
import platform
import re
from pathlib import Path

from zswarm.protocol.messages import LABEL_VALUE
from zswarm.ss.workers import memory

CPUINFO = Path("/proc/cpuinfo")
NAMES = ("name", "os", "machine", "cpu", "cores", "memory_mb", "slots", "slot_memory_mb")


def detected_labels(name: str, slots: int, slot_memory_mb: int) -> dict[str, str]:
    """Return labels by ``NAMES``, without those that the system does not report."""
    system = platform.system().lower(), platform.machine(), _cpu()
    numbers = os.cpu_count() or "", memory.machine_mb(), slots, slot_memory_mb
    labels = zip(NAMES, map(str, (name, *system, *numbers)), strict=True)
    return {
        label: value
        for label, value in labels
        if re.fullmatch(LABEL_VALUE, value, re.ASCII)
    }


def _cpu() -> str:
    """Return the model of the first processor as one word; "" where it is not known."""
    try:
        lines = CPUINFO.read_text(errors="replace").splitlines()
    except OSError:  # macOS
        return ""
    model = next(
        (line.partition(":")[2] for line in lines if line.startswith("model name")), ""
    )
    model = re.sub(r"\((R|TM)\)", "", model)
    return re.sub(r"[^A-Za-z0-9_.:+-]+", "-", model).strip("-_.:+")[:63]
