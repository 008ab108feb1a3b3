"""Figures for papers: what is in the file, and that no input breaks them."""

import json
import os
import re
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import zswarm
from tests.ot.invented_record import written
from tests.parameters import some
from zswarm.config.sections import StopConfig
from zswarm.errors import ConfigError
from zswarm.ot import cli
from zswarm.ot.analysis import curves, drawing, figures, grouping, picture
from zswarm.ot.analysis.curves import Series
from zswarm.ot.record.runs import runs_below

HOSTILE = [
    "$\\frac{$",
    "_hidden",
    "<script>alert(1)</script>",
    "漢字",
    "a" * 300,
    "$$",
    "\x1b[31m",
    "%s{}&quot;",
]


def run(best: list[float], seconds: float = 1.0) -> Series:
    values, generations = np.array(best, np.float64), np.arange(1.0, len(best) + 1)
    return Series(values, values - 1, generations * 50, generations * seconds)


def repeats(count: int, generations: int = 20, level: float = 0.0) -> list[Series]:
    return [
        run([level + number / 10 + generation for generation in range(generations)])
        for number in range(count)
    ]


def test_the_same_runs_give_the_same_bytes() -> None:
    """Each format is compared, and none contains a date."""
    for as_format in figures.FORMATS:
        first, second = (
            figures.render(
                figures.of_series({"a": repeats(4), "b": repeats(4, level=3)}), as_format
            )
            for _ in range(2)
        )
        assert first == second
        assert b"CreationDate" not in first
        assert b"dc:date" not in first


def test_a_pdf_has_the_width_of_a_column_and_its_fonts_as_truetype() -> None:
    content = figures.render(figures.of_series({"a": repeats(3)}), "pdf")
    assert re.search(rb"/MediaBox \[ 0 0 244\.8 ", content)  # 3.4 inches
    assert b"/CIDFontType2" in content
    assert b"/Type3" not in content


def test_an_svg_needs_no_font() -> None:
    assert b"<text" not in figures.render(figures.of_series({"a": repeats(3)}), "svg")


@pytest.mark.parametrize(
    "groups",
    [
        {"one": repeats(1)},
        {"one generation": repeats(1, generations=1)},
        {"one generation": repeats(5, generations=1), "each": repeats(5, generations=1)},
        {"negative": [run([-1e9, -1e6, -1e-3])]},
        {"failed at first": [run([-np.inf, -np.inf, 1, 2])]},
        {"failed": [run([-np.inf] * 3)]},
        {"failed in some": [run([-np.inf] * 3), run([1, 2, 3]), run([2, 3, 4])]},
        {"constant": [run([5.0] * 4)]},
        {"as large as floats are": [run([-1.7e308, 0.0, 1.7e308])]},
        {"begun": [run([])], "other": repeats(2)},
        {name: repeats(2, level=number) for number, name in enumerate(HOSTILE)},
        {f"setting {number}": repeats(2) for number in range(drawing.MAX_GROUPS)},
    ],
    ids=lambda groups: next(iter(groups)),
)
@pytest.mark.parametrize("axis", some(["generation", "time"], "generation"))
def test_all_kinds_of_runs_are_drawn(
    groups: dict[str, list[Series]], axis: figures.Axis
) -> None:
    """No warning occurs; a warning is an error in tests."""
    title = HOSTILE[0] if len(groups) > 1 else ""
    assert figures.render(figures.of_series(groups, axis, title=title), "png").startswith(
        b"\x89PNG"
    )


def test_more_groups_than_colours_can_distinguish_are_refused() -> None:
    with pytest.raises(ConfigError, match="are too many for one figure"):
        figures.of_series(
            {str(number): repeats(1) for number in range(drawing.MAX_GROUPS + 1)}
        )


def test_a_long_run_makes_a_small_file() -> None:
    noisy = np.random.default_rng(1).normal(0, 1, 50_000)
    drawn = run(np.maximum.accumulate(noisy).tolist())._replace(mean=noisy)
    assert len(figures.render(figures.of_series({"a": [drawn]}), "svg")) < 100_000


def test_groups_have_a_note_with_their_test() -> None:
    figure = figures.of_series({"a": repeats(8), "b": repeats(8, level=9)})
    (note,) = [text.get_text() for text in figure.axes[0].texts]
    assert (
        note
        == "bands: quartiles of 8 runs each\nMann-Whitney U after 20 generations: p < 0.001\n"
        "A12 = 1.00 of b over a"
    )


@pytest.mark.long
def test_runs_may_be_drawn_in_threads() -> None:
    """Each gives the bytes that it gives alone."""
    groups = [{"a": repeats(3, level=level)} for level in range(4)]
    alone = [figures.render(figures.of_series(group), "svg") for group in groups]
    found: dict[int, bytes] = {}

    def draw(number: int) -> None:
        found[number] = figures.render(figures.of_series(groups[number]), "svg")

    threads = [threading.Thread(target=draw, args=(number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [found[number] for number in range(4)] == alone


def test_a_name_without_a_known_format_is_refused_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(
        ConfigError, match=r"expected a name that ends in \.pdf, \.svg or \.png"
    ):
        figures.save(figures.of_series({"a": repeats(1)}), tmp_path / "figure.jpg")


# ---- in the run's folder


def test_a_picture_is_saved_in_the_folder(tmp_path: Path) -> None:
    folder = written(tmp_path, [1, 2, 3], finished=False)
    picture.save_picture(folder)
    assert (folder / "fitness.png").read_bytes().startswith(b"\x89PNG")


def test_a_picture_that_fails_is_not_there(tmp_path: Path) -> None:
    folder = written(tmp_path, [1, 2, 3])
    (folder / "fitness.png.part").mkdir()
    picture.save_picture(folder)
    picture.save_picture(tmp_path / "none")
    assert not (folder / "fitness.png").exists()


def test_without_the_extra_or_a_generation_there_is_no_picture(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun = written(tmp_path, [], finished=False)
    picture.save_picture(begun)
    monkeypatch.setattr(picture.importlib.util, "find_spec", lambda _: None)
    folder = written(tmp_path, [1, 2, 3])
    picture.save_picture(folder)
    assert not (begun / "fitness.png").exists()
    assert not (folder / "fitness.png").exists()


# ---- the commands


def invoke(*arguments: object) -> str:
    result = CliRunner().invoke(
        cli.command, [str(argument) for argument in arguments], catch_exceptions=False
    )
    assert result.exit_code == 0
    return result.output


@pytest.fixture
def study(tmp_path: Path) -> Path:
    """Write runs of two settings with four seeds each; return their folder."""
    for hidden in (1, 2):
        for seed in range(4):
            written(
                tmp_path / f"hidden-{hidden}",
                [hidden, hidden + seed / 8],
                hidden=hidden,
                seed=seed,
            )
    return tmp_path


def test_plot_writes_the_figure_and_its_numbers(study: Path) -> None:
    output, numbers = study / "figure.svg", study / "figure.csv"
    said = invoke("plot", study, "-o", output, "--csv", numbers)
    assert said == f"{output}: 8 runs in 2 groups\n"
    assert output.read_text().startswith("<?xml")
    assert numbers.read_text().splitlines()[:3] == [
        '"group","runs","generation","median","q25","q75"',
        '"hidden 1",4,0,1.0,1.0,1.0',
        '"hidden 1",4,1,1.1875,1.09375,1.28125',
    ]


def test_generations_in_csv_are_those_of_the_record(study: Path) -> None:
    """The two tables can thus be joined."""
    _, rows = figures.table(
        curves.load(grouping.groups(runs_below([study])))[0], "generation"
    )
    recorded = [row["generation"] for row in runs_below([study])[0].history()]
    assert [row[2] for row in rows] == recorded * 2


def test_plot_reports_incomparable_groups_and_where_a_curve_ends(tmp_path: Path) -> None:
    written(tmp_path / "a", [1.0, 2.0, 3.0])
    written(tmp_path / "b", [1.0, 2.0], seed=2)
    said = invoke("plot", tmp_path, "-o", tmp_path / "figure.svg")
    assert (
        "stadium: the curve ends at generation 2, which all of its runs reached; the longest "
        "went to generation 3\n" in said
    )
    assert "compare" not in said
    written(tmp_path / "c", [1.0, 2.0], seed=3, simulator="minisim")
    said = invoke("plot", tmp_path, "-o", tmp_path / "figure.svg")
    assert (
        "runs of different problems (emergency-exit, minisim): their fitness does not compare\n"
        in said
    )


def test_runs_with_a_budget_are_drawn_over_what_compare_compares_by(
    tmp_path: Path,
) -> None:
    """After the two generations that all of them have, neither would be better."""
    budget = StopConfig(simulations=96)
    few, many = [float(step) for step in range(16)], [1.0, 2.0]
    for seed in range(4):
        more = {"seed": seed, "stop": budget}
        written(tmp_path / "few", few, trials=2, **more)
        written(tmp_path / "many", many, trials=16, **more)
    output, numbers = tmp_path / "figure.svg", tmp_path / "figure.csv"
    invoke("plot", tmp_path, "-o", output, "--csv", numbers)
    assert numbers.read_text().startswith('"group","runs","simulations",')
    by = json.loads(invoke("compare", tmp_path, "--json"))["by"]
    assert picture.usual_axis(runs_below([tmp_path])) == by == "simulations"
    note = zswarm.plot(tmp_path).axes[0].texts[0].get_text()
    assert "Mann-Whitney U after 96 simulations: p = 0.029\n" in note
    assert note.endswith("A12 = 1.00 of trials 2 over trials 16")
    asked = zswarm.plot(tmp_path, x="generation").axes[0].texts[0].get_text()
    assert "after 2 generations" in asked
    written(tmp_path / "without", few)
    assert picture.usual_axis(runs_below([tmp_path])) == "generation"


@pytest.mark.parametrize("shape", ["curves", "box"])
def test_runs_that_never_began_are_not_counted_as_drawn(
    tmp_path: Path, shape: str
) -> None:
    written(tmp_path, [1.0, 2.0])
    written(tmp_path, [], finished=False)
    output = tmp_path / "figure.svg"
    said = invoke("plot", tmp_path, "-o", output, "--as", shape)
    assert said.endswith(
        f"{output}: 1 run in 1 group; not drawn: 1 run without a finished generation\n"
    )


def test_the_lowest_fitness_shown_is_below_the_greatest() -> None:
    """Early values far below do not crush the rest."""
    groups = {"a": [run([-400.0, 1.0, 2.0])]}
    low, high = figures.of_series(groups, lowest=-1.0).axes[0].get_ylim()
    assert low == -1.0
    assert 2.0 < high < 3.0
    for lowest in (2.0, np.nan, -np.inf):
        with pytest.raises(
            ConfigError, match="lowest: expected a number below the greatest fitness, 2"
        ):
            figures.of_series(groups, lowest=lowest)


def test_a_band_needs_three_runs() -> None:
    """Quartiles of two are their values."""
    drawn = figures.of_series({"two": repeats(2), "three": repeats(3, level=1.0)}).axes[0]
    assert len(drawn.collections) == 1
    assert drawn.texts[0].get_text().startswith("bands: quartiles of 3 runs each")


@pytest.mark.long
def test_plot_leaves_other_programs_figures_alone(
    study: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It works without pyplot, and without a display; a user's style changes nothing."""
    (study / "matplotlibrc").write_text(
        "lines.linewidth: 20\nfont.size: 30\naxes.ymargin: 0.9\n"
    )
    code = (
        "import sys; from zswarm.ot.cli import command; "
        "command.main(['plot', '.', '-o', 'styled.png'], standalone_mode=False); "
        "sys.exit('matplotlib.pyplot' in sys.modules)"
    )
    environment = {key: value for key, value in os.environ.items() if key != "DISPLAY"}
    subprocess.run(
        [sys.executable, "-c", code],
        cwd=study,
        env=environment,
        check=True,
        capture_output=True,
    )
    monkeypatch.chdir(study)
    invoke("plot", ".", "-o", "plain.png")
    assert (study / "plain.png").read_bytes() == (study / "styled.png").read_bytes()


def test_compare_shows_the_groups_and_the_result_of_the_test(
    study: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    said = invoke("compare", study)
    assert re.search(r"hidden 2 +4 +2\.188", said)
    assert "hidden 2 has a higher best fitness in search than hidden 1" in " ".join(
        said.split()
    )
    assert max(map(len, said.splitlines())) <= 80


def test_compare_as_json_holds_all_numbers(study: Path) -> None:
    found = json.loads(invoke("compare", study, "--json"))
    assert [row["group"] for row in found["rows"]] == ["hidden 1", "hidden 2"]
    assert found["pairs"][0]["p"] == pytest.approx(2 / 70)
    assert found["families"][0]["at"] == 2


@pytest.mark.parametrize("name", ["plot", "compare"])
def test_csv_and_json_are_not_mixed_on_stdout(study: Path, name: str) -> None:
    ended = CliRunner().invoke(cli.command, [name, str(study), "--csv", "-", "--json"])
    assert isinstance(ended.exception, ConfigError)
    assert "both write to stdout" in str(ended.exception)
    assert not ended.stdout


def test_compare_as_csv_is_the_table(study: Path) -> None:
    said = invoke("compare", study, "--csv", "-").splitlines()
    assert said[0].startswith(
        '"what","group","runs","median","q25","q75","best","worst","evaluations",'
        '"seconds","held_out",'
    )
    assert said[1].startswith(
        '"group","hidden 1",4,1.1875,1.09375,1.28125,1.375,1.0,6.0,'
    )


def test_reading_does_not_change_the_runs(study: Path) -> None:
    def contents() -> dict[Path, bytes]:
        return {path: path.read_bytes() for path in study.rglob("*") if path.is_file()}

    before = contents()
    invoke("compare", study)
    grouping.groups(runs_below([study]))
    assert contents() == before


def test_figures_of_unknown_axes_and_sizes_are_refused_with_the_choices(
    tmp_path: Path,
) -> None:
    run = written(tmp_path, [1.0, 2.0])
    with pytest.raises(
        ValueError,
        match="x: expected generation, evaluations, simulations or time, not 'gen'",
    ):
        zswarm.plot(run, x="gen")  # type: ignore[arg-type]
    with pytest.raises(
        ValueError, match=r"size: expected column, page, slides or screen, not 'huge'"
    ):
        zswarm.plot(run, size="huge")  # type: ignore[arg-type]


def test_the_numbers_are_written_even_without_matplotlib(
    study: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(ConfigError, match="plot needs matplotlib"):
        invoke("plot", study, "-o", study / "x.png", "--csv", study / "x.csv")
    assert (study / "x.csv").read_text().startswith('"group",')
    assert not (study / "x.png").exists()


def test_numbers_of_boxes_are_refused_with_where_they_are(study: Path) -> None:
    with pytest.raises(
        ConfigError, match=r"--csv has the numbers of curves; .*compare --csv"
    ):
        invoke("plot", study, "--as", "box", "--csv", "-")


def test_a_figure_and_a_page_are_named_after_what_they_show(
    study: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(study)
    assert invoke("plot", "hidden-1").startswith("hidden-1.pdf: ")
    assert invoke("plot", "hidden-1", "hidden-2").startswith("comparison.pdf: ")
    with pytest.raises(
        ConfigError, match=r"page\.pdf: expected a name that ends in \.html or \.htm"
    ):
        invoke("report", "hidden-1", "-o", "page.pdf")


def test_piped_output_is_not_folded(study: Path) -> None:
    """Names of any length stay whole."""
    long = study / ("a-long-name-" * 12)
    (study / "hidden-1").rename(long)
    environment = {key: value for key, value in os.environ.items() if key != "COLUMNS"}
    done = subprocess.run(
        [sys.executable, "-m", "zswarm.ot", "list", str(study)],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert f"{long}/" in done.stdout
