"""The dashboard in a browser: each page, what is hostile, what breaks, and how long it takes."""

import http.server
import os
import re
import sqlite3
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect

from tests.browser.conftest import Dashboard, Watched
from tests.browser.records import BEGUN, assess, from_the_future, grow, write
from tests.ot.record.sealing import reseal
from zswarm.champion.held_out import HeldOut, Tracked
from zswarm.ot.record import annotations
from zswarm.ot.record import control_file as control
from zswarm.ot.record.folder import lock_folder

pytestmark = pytest.mark.browser

Start = Callable[..., Dashboard]
HOSTILE = '<img src=x onerror="document.title=1"><script>document.title=1</script>'
PAGES = ("/", "/run?run=long", "/cluster?run=long", "/candidate?run=long")
FIRST_CURVE = "() => performance.getEntriesByName('curve')[0].startTime"

# ---- the pages


def test_all_runs_are_listed_and_their_curves_drawn_over_one_another(
    page: Page, dashboard: Start, tmp_path: Path
) -> None:
    for seed in range(1, 4):
        write(tmp_path / "runs" / "study", f"seed-{seed}", seed=seed)
    write(tmp_path / "runs", "alone")
    page.goto(dashboard(tmp_path / "runs").url)
    expect(page.locator(".tall tbody tr")).to_have_count(4)
    expect(page.get_by_role("link", name="study/seed-2")).to_be_visible()
    expect(page.locator(".legend .key")).to_have_count(4)
    page.get_by_text("median and quartiles").click()
    expect(page.locator(".legend .key").first).to_have_text("quartiles")
    page.get_by_text("wall time").click()
    page.get_by_label("draw alone").uncheck()
    expect(page.locator(".legend .key", has_text="median of 3 runs")).to_be_visible()
    page.get_by_text("what differs").click()
    expect(page.locator("details tbody tr").first).to_contain_text("seed")
    page.get_by_label("Filter runs").fill("alone")
    expect(page.locator(".tall tbody tr")).to_have_count(1)
    page.get_by_role("link", name="alone").click()
    expect(page.get_by_role("heading", level=1)).to_have_text("alone")


def test_runs_are_drawn_by_study_and_problem_and_a_link_reproduces_it(
    page: Page, dashboard: Start, tmp_path: Path
) -> None:
    for seed in range(1, 4):
        write(tmp_path / "study", f"seed-{seed}", seed=seed)
    write(tmp_path, "alone")
    other = ["problem.simulator=xor", "problem.settings={}", "problem.trials=1"]
    write(tmp_path, "other", settings=other)
    page.goto(dashboard(tmp_path).url)
    expect(page.locator(".chart:visible")).to_have_count(2)
    expect(page.get_by_role("heading", name="xor")).to_be_visible()
    page.get_by_role("button", name="study (3)").click()
    expect(page.locator(".chart:visible")).to_have_count(1)
    expect(page.locator(".legend:visible .key")).to_have_count(3)
    page.get_by_text("logarithmic").click()
    page.reload()
    expect(page.locator(".legend:visible .key")).to_have_count(3)
    expect(page.get_by_label("logarithmic")).to_be_checked()
    page.get_by_label("Filter runs").fill("alone")
    page.get_by_role("button", name="tick shown").click()
    expect(page.locator(".legend:visible .key")).to_have_count(4)
    page.get_by_role("button", name="none").click()
    page.evaluate("sessionStorage.clear()")
    page.goto(page.url.split("?")[0] + "?runs=alone+other&scale=log")
    expect(page.locator(".chart:visible")).to_have_count(2)
    expect(page.locator(".legend:visible .key")).to_have_count(2)


def test_medians_are_of_all_runs_of_a_setting_up_to_the_end_of_the_first(
    page: Page, dashboard: Start, tmp_path: Path
) -> None:
    for seed in range(1, 17):
        write(tmp_path, f"short-{seed}", seed=seed, generations=20)
    write(tmp_path, "long", seed=17, generations=60)
    for seed in range(1, 3):
        other = ["problem.trials=7"]
        write(tmp_path, f"other-{seed}", seed=seed, generations=10, settings=other)
    page.goto(dashboard(tmp_path).url)
    expect(page.locator(".tall tbody tr")).to_have_count(19)
    for box in page.get_by_label(re.compile("^draw ")).all():
        box.check()
    expect(page.locator(".legend .key")).to_have_count(14)
    expect(page.get_by_text("14 of 19 chosen runs are drawn")).to_be_visible()
    page.get_by_text("median and quartiles").click()
    expect(page.locator(".legend .key", has_text="median of 17 runs")).to_be_visible()
    expect(page.locator(".legend .key", has_text="2 runs: trials 7")).to_be_visible()
    expect(page.get_by_text("chosen runs are drawn")).not_to_be_visible()
    page.locator(".chart svg[role=img]").first.focus()
    page.keyboard.press("End")  # of the median, which has the most points
    expect(page.locator(".readout").first).to_contain_text("generation 20: median of 17")


def test_medians_have_labels_and_settings_an_importance(
    page: Page, dashboard: Start, tmp_path: Path
) -> None:
    for seed in (1, 2, 3):
        for hidden, length in ((2, 20), (3, 40)):
            settings = [f"representation.hidden={hidden}", f'label="H{hidden}"']
            name = f"h{hidden}-{seed}"
            long = {"generations": length, "seed": seed, "settings": settings}
            write(tmp_path / "study", name, **long)
    page.goto(dashboard(tmp_path).url)
    page.get_by_text("median and quartiles").click()
    page.get_by_role("button", name="study (6)").click()
    expect(page.locator(".legend .key", has_text="median of 3 runs: H3")).to_be_visible()
    page.get_by_text("importance of settings").click()
    expect(page.get_by_role("cell", name="representation.hidden")).to_be_visible()
    page.get_by_role("button", name="none").click()
    expect(page.get_by_text("importance of settings")).not_to_be_visible()


def test_tags_and_a_note_are_written_on_a_page_and_filter_the_runs(
    page: Page, dashboard: Start, tmp_path: Path
) -> None:
    write(tmp_path)
    write(tmp_path, "other")
    shown = dashboard(tmp_path)
    page.goto(f"{shown.url}/run?run=long")
    expect(page.get_by_label("note", exact=True)).to_be_disabled()
    page.goto(f"{shown.url}/#token={shown.token}")
    page.get_by_role("link", name="long").click()
    page.get_by_label("tags, with commas").fill("paper, baseline")
    page.get_by_label("note", exact=True).fill(HOSTILE)
    page.get_by_role("button", name="Save").click()
    expect(page.get_by_text("saved", exact=True)).to_be_visible()
    page.get_by_role("link", name="Runs").click()
    expect(page.locator(".tag")).to_have_text(["baseline", "paper"])
    expect(page.get_by_text(HOSTILE)).to_be_visible()
    page.get_by_label("Filter runs").fill("paper")
    expect(page.locator(".tall tbody tr")).to_have_count(1)
    annotations.save(tmp_path / "other", annotations.Annotations(tags=["paper 2"]))
    expect(page.locator(".tall tbody tr")).to_have_count(2)


def test_a_study_of_a_hundred_runs_opens_with_a_few_requests(
    page: Page, dashboard: Start, tmp_path: Path, watched: Watched
) -> None:
    for seed in range(1, 101):
        write(tmp_path / "study", f"seed-{seed}", seed=seed, generations=3)
    page.goto(dashboard(tmp_path).url)
    page.get_by_text("median and quartiles").click()
    page.get_by_role("button", name="study (100)").click()
    expect(page.locator(".legend .key", has_text="median of 100 runs")).to_be_visible()
    asked = [url for url in watched.requests if "/api/" in url]
    assert len(asked) <= 3  # the newest five runs, then two halves of the study


def test_the_page_of_a_run_shows_progress_events_and_settings(
    page: Page, dashboard: Start, tmp_path: Path
) -> None:
    events = [
        (BEGUN + 5, 4, "fault", "lab-1-0123abcd", "crashed: signal 11", 0),
        (BEGUN + 5, 4, "requeued", "", "", 7),
    ]
    write(tmp_path, events=events)
    page.goto(f"{dashboard(tmp_path).url}/run?run=long")
    expect(page.locator(".badge")).to_contain_text("finished")
    expect(page.locator(".tile", has_text="generation")).to_contain_text("100 / 100")
    expect(page.locator(".tile", has_text="sent again")).to_contain_text("7")
    for key in ("best in search", "mean", "median", "quartiles"):
        expect(page.locator(".legend").first.get_by_text(key, exact=True)).to_be_visible()
    expect(page.get_by_role("heading", name="Diversity")).to_be_visible()
    expect(page.get_by_role("heading", name="Effectivity of operators")).to_be_visible()
    expect(page.locator(".log li")).to_have_count(5)
    page.get_by_text("errors", exact=True).click()
    expect(page.locator(".log li")).to_have_count(1)
    expect(page.locator(".log li")).to_contain_text("lab-1-0123abcd: crashed: signal 11")
    expect(page.locator("pre")).to_contain_text('simulator = "emergency-exit"')
    page.get_by_text("wall time").click()
    page.locator(".chart svg[role=img]").first.focus()
    page.keyboard.press("Home")
    expect(page.locator(".readout").first).to_contain_text(
        "since the run began 1.0 s: best"
    )
    page.keyboard.press("ArrowRight")
    expect(page.locator(".readout").first).to_contain_text("2.0 s")
    page.keyboard.press("Enter")
    expect(page.get_by_role("link", name="look at its best candidate")).to_have_attribute(
        "href", re.compile("generation=1")
    )


def test_held_out_values_are_next_to_those_in_search(
    page: Page, dashboard: Start, tmp_path: Path
) -> None:
    """The champion's level and tile, and the best of each twentieth generation."""

    def numbers(mean: float) -> HeldOut:
        ends = {"low": mean - 0.05, "high": mean + 0.05}
        return HeldOut(mean=mean, **ends, seeds=100, in_search=mean + 0.1)

    tracked = [
        Tracked(generation=at, held_out=numbers(0.2 + at / 200))
        for at in range(19, 100, 20)
    ]
    assess(write(tmp_path), numbers(0.75), tracked)
    url = dashboard(tmp_path).url
    page.goto(url)
    heads = page.locator(".tall thead")
    for head in ("best in search", "held-out"):
        expect(heads).to_contain_text(head)
    expect(page.locator(".tall tbody tr")).to_contain_text("0.75")
    page.goto(f"{url}/run?run=long")
    tile = page.locator(".tile", has_text="champion, held-out")
    expect(tile).to_contain_text("0.75")
    interval = page.locator(".tile", has_text="its 95 %")
    expect(interval).to_contain_text("0.7 to 0.8")
    legend = page.locator(".legend").first
    for key in ("best in search", "best, held-out", "champion, held-out"):
        expect(legend.get_by_text(key, exact=True)).to_be_visible()
    page.locator(".chart svg[role=img]").first.focus()
    page.keyboard.press("End")
    read = page.locator(".readout").first
    expect(read).to_contain_text("generation 100: best, held-out 0.695")
    expect(read).to_contain_text("champion, held-out 0.75")


def test_the_data_of_a_page_can_be_downloaded(
    page: Page, dashboard: Start, tmp_path: Path
) -> None:
    write(tmp_path)
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    page.goto(f"{dashboard(tmp_path).url}/run?run=long")
    for name, begin in (("CSV", b'"generation"'), ("JSON", b"[{"), ("PNG", b"\x89PNG")):
        with page.expect_download() as saved:
            page.get_by_role("button", name=name, exact=True).click()
        assert saved.value.path().read_bytes().startswith(begin)
    page.get_by_role("button", name="copy seed").click()
    expect(page.get_by_role("button", name="copied")).to_be_visible()
    assert page.evaluate("() => navigator.clipboard.readText()") == "1"
    page.get_by_role("button", name="copy experiment").click()
    expect(page.get_by_role("button", name="copied")).to_have_count(2)
    assert 'simulator = "emergency-exit"' in page.evaluate(
        "() => navigator.clipboard.readText()"
    )


def test_a_table_shows_200_servers_and_their_work(
    page: Page, dashboard: Start, tmp_path: Path
) -> None:
    servers = [f"lab-{number:03}-{number:08x}" for number in range(200)]
    unused = ("server_mismatch", "old-1-0badf00d", "has no simulator emergency-exit", 0)
    write(tmp_path, servers=servers, generations=400, events=[(BEGUN, 0, *unused)])
    page.goto(f"{dashboard(tmp_path).url}/cluster?run=long")
    expect(page.locator("#servers tbody tr")).to_have_count(201)
    row = page.locator("#servers tbody tr", has_text="old-1-0badf00d")
    expect(row).to_contain_text("does not match")
    expect(row).to_contain_text("has no simulator emergency-exit")
    page.get_by_role("button", name="server", exact=True).click()
    expect(page.locator("#servers tbody tr").first).to_contain_text("lab-000-00000000")
    page.get_by_label("Filter servers").fill("lab-19")
    expect(page.locator("#servers tbody tr")).to_have_count(10)
    height = page.locator(".timeline").bounding_box()
    assert height is not None
    assert height["height"] > 200 * 10, "each server has its line"


def test_a_candidate_is_shown_with_genome_network_and_trials(
    page: Page, dashboard: Start, tmp_path: Path
) -> None:
    write(tmp_path)
    page.goto(f"{dashboard(tmp_path).url}/candidate?run=long")
    expect(page.locator("main")).to_contain_text("candidate 0 of generation 100")
    expect(page.locator("svg.network .node")).to_have_count(10 + 2 + 2)
    expect(page.locator("svg.network path")).to_have_count(4 * 14)
    page.locator("svg.network .node").last.focus()
    expect(page.locator(".readout", has_text="vy (bias")).to_contain_text("hears")
    page.get_by_label("candidate").select_option("3")
    expect(page.locator("main")).to_contain_text(
        "candidate 3 of generation 100: fitness 0.844"
    )
    assert page.url.endswith("generation=99&candidate=3")
    page.get_by_label("generation").fill("7")
    page.get_by_label("generation").press("Enter")
    expect(page.locator("main")).to_contain_text("candidate 0 of generation 7")
    expect(
        page.locator("section", has_text="Trials").locator("tbody tr").first
    ).to_contain_text("lab-")


def test_a_missing_generation_is_explained(
    page: Page, dashboard: Start, tmp_path: Path
) -> None:
    write(tmp_path)
    page.goto(f"{dashboard(tmp_path).url}/candidate?run=long&generation=700")
    expect(page.locator("main")).to_contain_text("generation 701 is not in the record")


# ---- live


def test_new_generations_appear_without_a_reload(
    page: Page, dashboard: Start, tmp_path: Path
) -> None:
    folder = write(tmp_path, finished=False)
    lock = lock_folder(folder)  # a program is at it
    page.goto(f"{dashboard(tmp_path).url}/run?run=long")
    expect(page.locator(".badge")).to_contain_text("running")
    expect(page.locator(".tile", has_text="generation")).to_contain_text("100 / 105")
    grow(folder, 100, 2.5)
    expect(page.locator(".tile", has_text="generation")).to_contain_text("101 / 105")
    expect(page.locator(".tile", has_text="best")).to_contain_text("2.5")
    expect(page.locator(".log li").first).to_contain_text("requeued (3)")
    os.close(lock)
    expect(page.locator(".badge")).to_contain_text("stopped")


def test_a_page_reconnects_to_a_restarted_dashboard(
    page: Page, watched: Watched, dashboard: Start, tmp_path: Path
) -> None:
    """The page shows its age, keeps its contents, and catches up after reconnecting."""
    folder = write(tmp_path, finished=False)
    shown = dashboard(tmp_path, options=["--port", "18467"])
    page.goto(f"{shown.url}/run?run=long")
    expect(page.locator(".tile", has_text="generation")).to_contain_text("100 / 105")
    shown.stop()
    expect(page.locator("#banner")).to_contain_text(
        "connection lost, retrying; what is shown is"
    )
    expect(page.locator(".tile", has_text="generation")).to_contain_text("100 / 105")
    grow(folder, 100, 2.5)
    shown.start()
    expect(page.locator("#banner")).to_be_hidden(timeout=20_000)
    expect(page.locator(".tile", has_text="generation")).to_contain_text("101 / 105")
    watched.forgive(page)  # the browser tells of each connection that failed


def test_a_reopened_page_shows_the_same(
    page: Page, dashboard: Start, tmp_path: Path
) -> None:
    write(tmp_path)
    shown = dashboard(tmp_path)
    page.goto(f"{shown.url}/#token={shown.token}")
    # The token stands in no address for longer than it takes to read it.
    expect(page).to_have_url(f"{shown.url}/")
    page.get_by_role("link", name="long").click()
    expect(page.locator(".tile", has_text="generation")).to_contain_text("100 / 100")
    page.reload()
    expect(page.locator(".tile", has_text="generation")).to_contain_text("100 / 100")


def test_a_run_is_paused_and_stopped_with_the_token_alone(
    page: Page, dashboard: Start, tmp_path: Path
) -> None:
    folder = write(tmp_path, finished=False)
    lock = lock_folder(folder)
    shown = dashboard(tmp_path)
    page.goto(f"{shown.url}/run?run=long")
    expect(page.get_by_role("button", name="Pause")).to_be_disabled()
    page.goto(f"{shown.url}/#token={shown.token}")
    page.get_by_role("link", name="long").click()
    page.get_by_role("button", name="Pause").click()
    expect(page.locator(".badge")).to_contain_text("paused")
    assert control.asked(folder) == "pause"
    page.get_by_role("button", name="Resume").click()
    expect(page.locator(".badge")).to_contain_text("running")
    assert control.asked(folder) == ""
    page.on("dialog", lambda dialog: dialog.accept())
    page.get_by_role("button", name="Stop", exact=True).click()
    expect(page.locator(".badge")).to_contain_text("stopping")
    assert control.asked(folder) == "stop"
    os.close(lock)


# ---- hostile and broken


def test_hostile_names_are_text(page: Page, dashboard: Start, tmp_path: Path) -> None:
    """Folders, servers and events may have such names; terminal escapes are shown as text."""
    folder = write(
        tmp_path,
        f"x{HOSTILE.replace('/', '')}",
        servers=[HOSTILE, "lab\u202e-1"],
        events=[(BEGUN, 0, HOSTILE, HOSTILE, f"\x1b[2J{HOSTILE}", 1)],
    )
    with sqlite3.connect(folder / "run.sqlite") as database:
        database.execute(
            "UPDATE generations SET statistics = ?",
            (f'{{"best": 1, "mean": 0, "{HOSTILE.replace(chr(34), chr(39))}": 1}}',),
        )
    database.close()
    reseal(folder)
    url = dashboard(tmp_path).url
    page.goto(url)
    page.locator(".tall tbody a").click()
    expect(page.locator(".log")).to_contain_text(f"\\x1b[2J{HOSTILE}")
    expect(page.get_by_role("heading", level=1)).to_contain_text("<script>")
    expect(page.get_by_role("heading", name="Other numbers")).to_be_visible()
    page.get_by_role("link", name="Servers").click()
    expect(page.locator("#servers")).to_contain_text(HOSTILE)
    expect(page.locator("#servers")).to_contain_text("lab\\x202e-1")
    page.get_by_role("link", name="Candidate").click()
    expect(page.locator("main")).to_contain_text(HOSTILE)
    assert page.title() != "1"
    assert page.locator("main img, main script").count() == 0


def test_records_that_cannot_be_read_are_explained(
    page: Page, watched: Watched, dashboard: Start, tmp_path: Path
) -> None:
    """Truncated, or of a newer zswarm; the others are shown all the same."""
    write(tmp_path, "whole")
    cut = write(tmp_path, "cut") / "run.sqlite"
    cut.write_bytes(cut.read_bytes()[:-1000])
    from_the_future(write(tmp_path, "newer"))
    url = dashboard(tmp_path).url
    page.goto(url)
    expect(page.locator("tr", has_text="cut")).to_contain_text("damaged")
    expect(page.locator("tr", has_text="newer")).to_contain_text(
        "use the zswarm that made the record"
    )
    expect(page.locator("tr", has_text="whole")).to_contain_text("finished")
    page.goto(f"{url}/run?run=newer")
    expect(page.get_by_role("heading", name="This cannot be shown")).to_be_visible()
    page.goto(f"{url}/run?run=..%2f..%2fetc")
    expect(page.locator("main")).to_contain_text("no such run")
    watched.forgive(page)  # the browser tells of each answer that was no


@pytest.fixture
def elsewhere() -> Iterator[str]:
    """Serve a web page of another origin."""

    class Empty(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("content-type", "text/html")
            self.end_headers()
            self.wfile.write(b"<link rel=icon href=data:,>")

        def log_message(self, *_: object) -> None:
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Empty)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    server.server_close()


def test_a_page_of_another_origin_can_neither_read_nor_write(
    page: Page, watched: Watched, dashboard: Start, elsewhere: str, tmp_path: Path
) -> None:
    """No request, form, WebSocket, frame or script succeeds, not even one with the token."""
    folder = write(tmp_path, finished=False)
    shown = dashboard(tmp_path)
    page.goto(elsewhere)
    read = "([url]) => fetch(url).then((answer) => answer.text(), () => 'refused')"
    assert page.evaluate(read, [f"{shown.url}/api/runs"]) == "refused"
    told = """([url, token]) => fetch(url, {
        method: 'POST', mode: 'no-cors',
        headers: token ? {Authorization: 'Bearer ' + token} : {},
    }).then((answer) => answer.type, () => 'refused')"""
    for token in ("", shown.token):
        assert page.evaluate(
            told, [f"{shown.url}/api/runs/long/control/stop", token]
        ) in (
            "refused",
            "opaque",
        )
    assert control.asked(folder) == ""
    listen = """([url]) => new Promise((done) => { const socket = new WebSocket(url);
        socket.onmessage = () => done('heard'); socket.onerror = () => done('refused'); })"""
    assert (
        page.evaluate(listen, [f"{shown.url.replace('http', 'ws')}/ws?run=long"])
        == "refused"
    )
    page.evaluate(
        "([url]) => { const frame = document.createElement('iframe'); frame.src = url; "
        "document.body.append(frame); }",
        [shown.url],
    )
    expect(page.frame_locator("iframe").locator("h1", has_text="Runs")).to_have_count(0)
    watched.forgive(page)  # the browser tells of what it refused


# ---- much of it


def test_twelve_tabs_are_live_at_once(
    browser: Browser, watched: Watched, dashboard: Start, tmp_path: Path
) -> None:
    folder = write(tmp_path, finished=False)
    url = dashboard(tmp_path).url
    context = browser.new_context()
    tabs = [watched.watch(context.new_page()) for _ in range(12)]
    for tab in tabs:
        tab.goto(f"{url}/run?run=long")
    for tab in tabs:
        expect(tab.locator(".tile", has_text="generation")).to_contain_text("100 / 105")
    grow(folder, 100, 2.5)
    for tab in tabs:
        expect(tab.locator(".tile", has_text="generation")).to_contain_text("101 / 105")
    context.close()
    assert watched.errors == []


@pytest.mark.parametrize("generations", [100, 20_000])
def test_a_long_run_is_shown_as_soon_as_a_short_one(
    page: Page, dashboard: Start, tmp_path: Path, generations: int
) -> None:
    """It draws as many points at most; the time is printed."""
    write(tmp_path, generations=generations)
    url = dashboard(tmp_path).url
    page.goto(url)
    page.goto(f"{url}/run?run=long")
    expect(page.locator(".tile", has_text="generation")).to_contain_text(
        f"{generations:,} / {generations:,}"
    )
    expect(
        page.locator(".legend").first.get_by_text("median", exact=True)
    ).to_be_visible()
    print(
        f"{generations} generations: first curve after {page.evaluate(FIRST_CURVE):.0f} ms"
    )
    points = page.evaluate(
        "() => fetch('/api/runs/long/curve').then((answer) => answer.json()).then((found) => "
        "found.best.length)"
    )
    assert points == min(generations, 2000)


@pytest.mark.parametrize("path", PAGES)
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_pages_fit_on_a_phone(
    page: Page, dashboard: Start, tmp_path: Path, path: str, scheme: str
) -> None:
    """Only tables and curves scroll sideways at 400 pixels, and texts have enough contrast."""
    write(tmp_path)
    page.emulate_media(
        color_scheme="dark" if scheme == "dark" else "light", reduced_motion="reduce"
    )
    page.set_viewport_size({"width": 400, "height": 800})
    page.goto(f"{dashboard(tmp_path).url}{path}")
    expect(page.locator("h1")).to_be_visible()
    expect(page.locator("#link")).to_have_text("live")
    assert page.evaluate("() => document.documentElement.scrollWidth") <= 400
