"""Shared memory by name: reported when it is created and removed."""

from collections.abc import Iterator
from multiprocessing.shared_memory import SharedMemory

import pytest

from zswarm.system import shared_memory


@pytest.fixture
def reports() -> Iterator[list[tuple[str, bool]]]:
    found: list[tuple[str, bool]] = []
    stop = shared_memory.watch(lambda name, exists: found.append((name, exists)))
    yield found
    stop()


def test_what_is_created_and_removed_is_reported(reports: list[tuple[str, bool]]) -> None:
    memory = SharedMemory(create=True, size=10)
    name = f"/{memory.name}"
    assert reports == [(name, True)]
    SharedMemory(memory.name).close()
    assert len(reports) == 1, "to open another's is not to create it"
    with pytest.raises(FileExistsError):
        SharedMemory(memory.name, create=True, size=10)
    assert reports[1:] == [(name, True), (name, False)]
    memory.close()
    memory.unlink()
    assert reports[3:] == [(name, False)]


def test_what_is_gone_may_be_removed_again() -> None:
    memory = SharedMemory(create=True, size=10)
    memory.close()
    for _ in range(2):
        shared_memory.remove(f"/{memory.name}")
    with pytest.raises(FileNotFoundError):
        SharedMemory(memory.name)
