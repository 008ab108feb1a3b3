"""``zswarm-router`` prints one line when it is up and one for an error."""

import signal
from pathlib import Path

import pytest

from tests.integration.programs import Program, free_port, wait_until


def router(folder: Path, name: str, *options: str) -> Program:
    return Program(folder, name, ["-m", "zswarm.router", *options])


@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)]
)
def test_a_signal_ends_the_router_cleanly(tmp_path: Path, number: int, code: int) -> None:
    place = f"tcp/127.0.0.1:{free_port()}"
    program = router(tmp_path, "router", "--no-multicast", "--listen", place)
    try:
        ready = wait_until(
            lambda: program.events("router_ready"), "router_ready is logged"
        )
        assert len(ready) == 1
        assert (ready[0]["listen"], ready[0]["multicast"]) == ([place], False)
        program.kill(number)
        assert program.wait() == code
        assert len(program.err.read_text().splitlines()) == 3, (
            "in_the_clear, router_ready and router_stopped"
        )
        assert program.events("router_stopped")
    finally:
        program.close()


@pytest.mark.parametrize(
    ("config", "options", "code", "words"),
    [
        ("", ("--listen", "nonsense"), 2, "listen: expected endpoints such as"),
        (
            "listen = ['tcp/127.0.0.1:port']",
            ("--config", "router.toml"),
            78,
            "the port must be a number",
        ),
        ("lisen = []", ("--config", "router.toml"), 78, "did you mean 'listen'"),
        ("multicast = 3", ("--config", "router.toml"), 78, "multicast: expected bool"),
        ("=", ("--config", "router.toml"), 78, "router.toml"),
    ],
)
def test_a_mistake_is_named_in_one_line(
    tmp_path: Path, config: str, options: tuple[str, ...], code: int, words: str
) -> None:
    (tmp_path / "router.toml").write_text(config)
    program = router(tmp_path, "router", "--no-multicast", *options)
    assert program.wait() == code
    lines = program.err.read_text().splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("zswarm-router: ")
    assert words in lines[0]


def test_a_port_in_use_is_named(tmp_path: Path) -> None:
    options = ["--no-multicast", "--listen", f"tcp/127.0.0.1:{free_port()}"]
    first = router(tmp_path, "first", *options)
    try:
        wait_until(lambda: first.events("router_ready"), "the first one has the port")
        second = router(tmp_path, "second", *options)
        assert second.wait() == 2
        assert "the port is in use" in second.err.read_text()
    finally:
        first.close()
