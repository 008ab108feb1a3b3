"""Write docs/benchmarks.md, the README's table and the charts from ``results.json``.

``page.md`` has the text of the page, with names in braces for measured parts. Every missed target
needs a reason in ``missed.toml``; without it no page is written.
"""

import argparse
import json
import re
import tomllib
from pathlib import Path

import charts
import tables
from aims import Results, aims

HERE = Path(__file__).resolve().parent
REPOSITORY = HERE.parent
RESULTS = HERE / "results.json"
SCRIPTS = {
    "dispatch": tables.dispatch,
    "kernels": tables.kernels,
    "startup": tables.startup,
    "commands": tables.commands,
    "questions": tables.questions,
    "scaling": tables.scaling,
    "runs": tables.runs,
    "populations": tables.populations,
    "scale": tables.scale,
    "many_servers": tables.many_servers,
    "methods": tables.methods,
    "noise": tables.noise,
}
BESIDE = {  # first cell of a row in the README's table: its peer
    "zswarm": "zswarm",
    "`ProcessPoolExecutor`": "ProcessPoolExecutor",
    "joblib (loky)": "joblib (loky)",
    "mpi4py.futures": "mpi4py.futures",
    "Ray": "Ray",
    "Dask distributed": "Dask distributed",
    "MQTT, a message per candidate": "MQTT (stock)",
}
BY_STEP = "MQTT, a message per agent and step, as in the paper"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument(
        "--results", type=Path, default=RESULTS, help="[default: benchmarks/results.json]"
    )
    parser.add_argument(
        "--to",
        type=Path,
        default=REPOSITORY,
        help="a folder with docs/ and README.md [default: this one]",
    )
    parser.add_argument(
        "--draft", action="store_true", help="write the page even if reasons are missing"
    )
    options = parser.parse_args()
    results = json.loads(options.results.read_text(encoding="utf-8"))
    print(verdicts(results))
    page = document(results, draft=options.draft)
    readme = (REPOSITORY / "README.md").read_text(encoding="utf-8")
    pictures = options.to / "docs" / "pictures"
    pictures.mkdir(parents=True, exist_ok=True)
    charts.draw(results, pictures)
    (options.to / "docs" / "benchmarks.md").write_text(page, encoding="utf-8")
    (options.to / "README.md").write_text(beside(results, readme), encoding="utf-8")
    print(
        f"{options.to / 'docs' / 'benchmarks.md'}, README.md, docs/pictures/bench-*.png"
    )


def verdicts(results: Results) -> str:
    """Return the targets as a table."""
    return tables.markdown(
        ["quantity", "target", "measured", ""], [aim.row for aim in aims(results)]
    )


def document(results: Results, *, draft: bool = False) -> str:
    """Return docs/benchmarks.md.

    Raises:
        SystemExit: a target is missed, and missed.toml has no reason.
    """
    reasons = tomllib.loads((HERE / "missed.toml").read_text(encoding="utf-8"))
    missed = [aim for aim in aims(results) if not aim.held and aim.value is not None]
    reasons = (
        dict.fromkeys((aim.key for aim in missed), "no reason given yet.") | reasons
        if draft
        else reasons
    )
    if unsaid := [
        f"{aim.key!r} ({', '.join(aim.row[:3])})"
        for aim in missed
        if aim.key not in reasons
    ]:
        raise SystemExit(
            "benchmarks/missed.toml must give a reason for these missed targets: "
            f"{'; '.join(unsaid)}"
        )
    parts = {
        "aims": verdicts(results),
        "missed": "".join(
            f"- **{aim.what}**: {reasons[aim.key].strip()}\n" for aim in missed
        ),
    }
    for script, table in SCRIPTS.items():
        parts[script] = (
            f"{table(results[script])}\n{measured(results, script)}"
            if script in results
            else "Not measured yet.\n"
        )
        parts[f"{script}_chart"] = "".join(
            f"![{words}](pictures/bench-{name}.png)\n"
            for name, (of, words) in charts.CHARTS.items()
            if of == script in results
        )
    text = (HERE / "page.md").read_text(encoding="utf-8")
    text = re.sub(r"^\{(\w+)\}\n", lambda found: parts[found[1]], text, flags=re.M)
    return re.sub(r"\n{3,}", "\n\n", text)


def measured(results: Results, script: str) -> str:
    """Return when, where and with which versions something was measured."""
    found = results[script]
    machine = found["machine"]
    versions = ", ".join(
        f"{name} {version}" for name, version in found["versions"].items()
    )
    times = [
        f"{found[what]} {unit}"
        for what, unit in (("rounds", "rounds"), ("seconds", "s in all"))
        if what in found
    ]
    return (
        f"*{', '.join([found['when'], *times])}. {machine['cores']} cores of {machine['cpu']}, "
        f"{machine['gib']} GiB, "
        f"{machine['system']}, Python {machine['python']}; load {machine['load']} at the end. "
        f"{versions}.*\n"
    )


def beside(results: Results, readme: str) -> str:
    """Return README.md with its table of peers renewed."""
    if (found := results.get("dispatch")) is None:
        return readme

    def row(match: re.Match[str]) -> str:
        peer = BESIDE[match["name"]]
        noop, sleep = (
            tables.main_way(found, peer, work, 4, 400) for work in ("noop", "sleep")
        )
        if noop is None or sleep is None:
            return match[0]
        cost, efficiency = tables.figure(noop["us"]), tables.share(sleep["efficiency"])
        return f"| {match['name']} | {cost} | {efficiency} |"

    names = "|".join(map(re.escape, BESIDE))
    readme = re.sub(
        rf"^\| (?P<name>{names}) \| [\d.,]+ \| \.\d+ \|", row, readme, flags=re.M
    )
    for one in found["rows"]:
        if one["peer"] == "MQTT (stock)" and "steps" in one.get("form", ""):
            readme = re.sub(
                rf"^\| {BY_STEP} \| [\d.,]+ \|",
                f"| {BY_STEP} | {tables.figure(one['us'])} |",
                readme,
                flags=re.M,
            )
    return readme


if __name__ == "__main__":
    main()
