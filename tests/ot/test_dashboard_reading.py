"""What the dashboard reads of records: chosen points, servers, and what is new since the last look."""

import asyncio
import re
import shutil
from importlib import resources
from pathlib import Path
from typing import cast

import pytest
from starlette.websockets import WebSocket
from written import written

from zswarm.errors import ConfigError
from zswarm.ot import control
from zswarm.ot.dashboard import answers, app, hub, points, traces
from zswarm.ot.dashboard.fleet import Batch, Event, Fleet, busy
from zswarm.ot.dashboard.follower import Follower
from zswarm.ot.dashboard.hub import WAITING, Client, Hub, Room
from zswarm.ot.dashboard.shelf import Shelf
from zswarm.ot.dispatch import Note
from zswarm.ot.reading import Run
from zswarm.ot.record import Record


def test_a_curve_has_so_many_points_at_most_and_loses_no_peak(tmp_path: Path) -> None:
    run = Run(written(tmp_path, [number / 100 for number in range(99)] + [5.0]))
    whole, few = points.curve(run), points.curve(run, 10)
    assert whole["generation"] == list(range(100))
    assert few["generation"] == list(range(9, 100, 10))
    assert (few["best"][-1], max(few["high"]), min(few["low"])) == (5.0, 4.0, -1.0)
    assert whole["evaluations"][-1] == few["evaluations"][-1] == 300


def test_quartiles_are_of_the_candidates_of_some_generations(tmp_path: Path) -> None:
    run = Run(written(tmp_path, [1.0, 2.0, float("nan"), 4.0], candidates=5))
    assert points.spread(run)["median"] == pytest.approx([1.0, 2.0, 4.0], abs=1e-5)
    assert points.spread(run, 2)["generation"] == [1, 3]
    assert points.statistics(run)["values"]["mean"] == [0.0, 1.0, None, 3.0]


def test_champions_are_where_the_best_rose(tmp_path: Path) -> None:
    run = Run(written(tmp_path, [1.0, 1.0, 3.0, 3.0]))
    assert [one["generation"] for one in points.champions(run)] == [0, 2]


def test_a_look_finds_what_was_added_since_the_one_before(tmp_path: Path) -> None:
    """And tells nothing twice."""
    folder = written(tmp_path, [1.0, 2.0], finished=False, notes=[Note("server_joined", "lab-1-0123abcd", count=4)])
    follower = Follower(folder)
    first = follower.look()
    assert [row[0] for row in first["generations"]] == [0, 1]
    assert first["state"]["status"] == "stopped"
    assert (first["state"]["generation"], first["state"]["best"]) == (2, 2.0)
    assert [event["event"] for event in first["events"]] == ["server_joined"]
    assert first["servers"][0]["trials"] == 6
    assert follower.look() == {}
    record, _ = Record.open(folder)
    with record:
        record.note(Note("requeued", count=3))
        record.note(Note("server_lost", "lab-1-0123abcd"))
    later = follower.look()
    assert [event["level"] for event in later["events"]] == ["warning", "error"]
    assert later["state"]["requeued"] == 3
    assert (later["servers"][0]["state"], later["servers"][0]["losses"]) == ("lost", 1)


def test_a_run_that_goes_on_is_told_from_one_that_was_stopped(tmp_path: Path) -> None:
    """And one that was asked to pause from both."""
    folder = written(tmp_path, [1.0], finished=False)
    follower = Follower(folder)
    assert follower.look()["state"]["status"] == "stopped"
    record, _ = Record.open(folder)
    with record:
        assert follower.look()["state"]["status"] == "running"
        control.ask(folder, "pause")
        assert follower.look()["state"]["status"] == "paused"
        control.forget(folder)
        assert follower.look()["state"]["status"] == "running"
    assert follower.look()["state"]["status"] == "stopped"


def test_a_record_that_cannot_be_read_is_explained_and_may_become_whole(tmp_path: Path) -> None:
    folder = written(tmp_path, [1.0])
    file = folder / "run.sqlite"
    whole = file.read_bytes()
    file.write_bytes(whole[:5000])
    follower, shelf = Follower(folder), Shelf([tmp_path])
    state = follower.look()["state"]
    assert state["status"] == "unreadable"
    assert "damaged" in state["error"]
    assert "damaged" in shelf.rows()[0]["error"]
    file.write_bytes(whole)
    assert follower.look()["state"]["status"] == "finished"
    assert shelf.rows()[0]["generation"] == 1


def test_no_run_outside_the_folders_is_found(tmp_path: Path) -> None:
    """Neither by a path in place of an id, nor through a link."""
    inside, outside = tmp_path / "runs", written(tmp_path / "others", [1.0])
    written(inside, [1.0])
    (inside / "link").symlink_to(outside)
    shelf = Shelf([inside])
    assert [row["id"] for row in shelf.rows()] == ["stadium"]
    for id_ in ("../others/stadium", str(outside), "link", "..", "stadium/../../others/stadium", "%2e%2e", ""):
        assert shelf.folder(id_) is None


def test_ids_are_plain_whatever_a_folder_is_called(tmp_path: Path) -> None:
    folder = written(tmp_path, [1.0])
    shutil.move(folder, tmp_path / "<b>ü\u202e x")
    (row,) = Shelf([tmp_path]).rows()
    assert re.fullmatch(r"[A-Za-z0-9._~-]+", row["id"])
    assert "\u202e" not in row["name"]
    assert Shelf([tmp_path]).folder(row["id"]) == tmp_path / "<b>ü\u202e x"


def test_a_folder_need_not_be_there_yet(tmp_path: Path) -> None:
    shelf = Shelf([tmp_path / "runs"])
    assert shelf.rows() == []
    written(tmp_path / "runs", [1.0])
    assert [row["status"] for row in shelf.rows()] == ["finished"]


def test_what_an_address_asks_for_must_be_a_number(tmp_path: Path) -> None:
    run = Run(written(tmp_path, [1.0]))
    for text in ("", "-1", "1.5", "x", "1" * 40, "\u0663"):
        with pytest.raises(ConfigError, match="generation: expected a whole number"):
            answers.generation(run, {"generation": text})
    with pytest.raises(LookupError, match="generation 7 has no candidate 0; the record has 1 generations"):
        answers.candidate(run, {"generation": "7", "candidate": "0"})


def test_a_candidate_has_its_network_and_its_trials(tmp_path: Path) -> None:
    run = Run(written(tmp_path, [1.0]))
    found = answers.candidate(run, {"generation": "0", "candidate": "2"})
    assert [node["kind"] for node in found["graph"]["nodes"]] == ["input"] * 10 + ["hidden"] * 2 + ["output"] * 2
    assert len(found["graph"]["edges"]) == found["edges"] == 4 * 14
    assert (found["genes"], len(found["numbers"])) == (60, 60)
    assert [trial["server"] for trial in found["trials"]] == ["lab-1-0123abcd"]


def test_busy_slots_add_up_to_what_was_computed() -> None:
    """Between two batches of a server is a gap; what two slots did side by side is twice as high."""
    batches = [Batch(1, 0, 5, "a", 4.0, 10.0, 0), Batch(2, 0, 5, "a", 2.0, 20.0, 0), Batch(3, 0, 1, "b", 20.0, 20.0, 0)]
    found = busy(batches, {"a": 2}, 0.0, 20.0, 20)
    assert found["b"] == [1.0] * 20
    assert found["a"] == [0.0] * 8 + [2.0] * 2 + [0.0] * 9 + [2.0]


def test_who_computed_before_a_resume_has_to_join_anew() -> None:
    fleet = Fleet()
    fleet.happened([Event(1, 0.0, 0, "server_joined", "a", "", 4), Event(2, 1.0, 0, "server_slots", "a", "", 6)])
    assert (fleet.slots, fleet.serving) == (6, 1)
    fleet.happened([Event(3, 2.0, 0, "began", "", "", 1)])
    assert (fleet.slots, fleet.rows(2.0, going_on=True)[0]["state"]) == (0, "lost")
    fleet.happened([Event(4, 3.0, 0, "server_mismatch", "b", "has no simulator", 0)])
    assert {row["server"]: row["why"] for row in fleet.rows(3.0, going_on=True)}["b"] == "has no simulator"


def test_a_tab_that_takes_nothing_costs_so_much_and_no_more() -> None:
    client = Client()
    for _ in range(10 * WAITING):
        client.put(b"x")
    assert client.full
    assert client._queue.qsize() == WAITING


def test_a_tab_that_comes_back_is_told_what_it_missed() -> None:
    """By the number of the last message that it has; another dashboard's numbers count for nothing."""
    changes = iter([{"n": 1}, {"n": 2}, {"n": 3}])

    async def scenario() -> None:
        room = Room(lambda: next(changes, {}), lambda: {"all": True})
        first, second, third = Client(), Client(), Client()
        await room.enter(first, "")
        hello = await first.take()
        assert b'"hello":true' in hello
        seq = hello.split(b'"')[3].decode()
        while b'"n":3' not in await first.take():
            pass
        await room.enter(second, seq)
        assert [b'"n":2' in await second.take(), b'"n":3' in await second.take()] == [True, True]
        await room.enter(third, "0badf00d.1")
        assert b'"hello":true' in await third.take()
        for client in (first, second, third):
            room.leave(client)

    asyncio.run(scenario())


def test_what_is_asked_of_a_run_is_one_of_three_words(tmp_path: Path) -> None:
    """Whatever else stands in the file is nothing, and nothing is read to its end that has none."""
    assert control.asked(tmp_path) == ""
    control.ask(tmp_path, "drain")
    assert control.asked(tmp_path) == "drain"
    (tmp_path / "control").write_bytes(b"\xff" * 1_000_000)
    assert control.asked(tmp_path) == ""
    control.forget(tmp_path)
    control.forget(tmp_path)
    assert not control.Stop(tmp_path).is_set()
    control.ask(tmp_path, "stop")
    assert control.Stop(tmp_path).is_set()


def test_a_folder_that_cannot_be_written_says_so(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(ConfigError, match="cannot be written: Not a directory"):
        control.ask(tmp_path / "file", "stop")


def test_pages_make_text_and_never_markup() -> None:
    """No script or style stands in a page, and no text of a record is ever parsed."""
    pages = {file.name: file.read_text() for file in (resources.files("zswarm.ot.dashboard") / "pages").iterdir()}
    for name, text in pages.items():
        for word in (
            "innerHTML",
            "outerHTML",
            "insertAdjacentHTML",
            "document.write",
            "eval(",
            "new Function",
            "DOMParser",
            "http://",
            "https:",
        ):
            allowed = (name, word) in {("live.js", "https:")} or (word == "http://" and "http://www.w3.org/2000/svg" in text)
            assert word not in text or allowed, f"{name}: {word}"
    page = pages["index.html"]
    assert re.findall(r"<script(?![^>]* src=)|<style|style=| on\w+=", page) == []


class Stuck:
    """A tab whose connection takes nothing."""

    def __init__(self) -> None:
        self.query_params: dict[str, str] = {}
        self.closed: list[int] = []

    async def send_text(self, _text: str) -> None:
        await asyncio.Event().wait()

    async def receive(self) -> dict[str, str]:
        await asyncio.Event().wait()
        raise AssertionError

    async def close(self, code: int, _reason: str) -> None:
        self.closed.append(code)


def test_a_tab_that_is_stuck_is_closed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With the code that tells it to come again, and nobody is followed for it any more."""
    monkeypatch.setattr(app, "STUCK_S", 0.01)
    folder = written(tmp_path, [1.0])
    watched, tab = Hub(Shelf([tmp_path])), Stuck()
    asyncio.run(app._serve(cast(WebSocket, tab), watched, "stadium", folder))
    assert tab.closed == [1013]
    assert watched._rooms == {}


def test_there_are_so_many_tabs_and_no_more(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hub, "CLIENTS", 0)
    tab = Stuck()
    asyncio.run(app._serve(cast(WebSocket, tab), Hub(Shelf([tmp_path])), "", None))
    assert tab.closed == [1013]


def test_an_error_of_the_dashboard_itself_leaves_no_tab_waiting() -> None:
    """It is told to come again, and the next one that comes begins anew."""
    looks = iter([{"n": 1}])

    async def scenario() -> None:
        def look() -> dict[str, int]:
            try:
                return next(looks)
            except StopIteration:
                raise OSError("gone") from None

        room, client = Room(look, dict), Client()
        await room.enter(client, "")
        while await client.take():
            pass
        assert client.full
        with pytest.raises(OSError, match="gone"):
            await cast("asyncio.Task[None]", room._task)
        room.leave(client)

    asyncio.run(scenario())


# ---- replays


def trace_of(program: str, monkeypatch: pytest.MonkeyPatch, *more: str) -> list[bytes]:
    """What a page gets when the program that computes traces is another one; several are asked for one after the other."""
    programs = iter([program, *more])
    monkeypatch.setattr(traces, "MODULE", "json")
    kept = traces.Traces()

    async def ask() -> list[bytes]:
        found = []
        for one in programs:
            monkeypatch.setattr(traces, "PROGRAM", one)
            found.append(await kept.of(Path("run"), 0, 1, 2))
        return found

    return asyncio.run(ask())


def test_a_replay_is_computed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """By a program that is told run, generation, candidate and trial, and that may evaluate."""
    monkeypatch.setenv("ZSWARM_PLAIN", "1")
    told = "import os, sys; print(os.path.basename(sys.argv[1]), *sys.argv[2:], os.environ.get('ZSWARM_PLAIN'), end='')"
    assert trace_of(told, monkeypatch, "raise SystemExit(1)") == [b"run 0 1 2 None"] * 2


def test_why_there_is_no_replay_is_told_in_a_line(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ConfigError, match=r"^trial 2 is not there\\x1b$"):
        trace_of("import sys; sys.stderr.write('warning\\n'); sys.exit('trial 2 is not there\\x1b')", monkeypatch)
    with pytest.raises(ConfigError, match="the program that computes it ended"):
        trace_of("import os; os._exit(3)", monkeypatch)


def test_a_replay_that_takes_too_long_or_too_much_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(traces, "LARGEST", 100)
    with pytest.raises(ConfigError, match="the replay has 1,000 bytes, and 100 is the most"):
        trace_of("print('x' * 1000, end='')", monkeypatch)
    monkeypatch.setattr(traces, "LONGEST_S", 0.05)
    with pytest.raises(ConfigError, match="the replay takes longer than 0 s"):
        trace_of("import time; time.sleep(60)", monkeypatch)
