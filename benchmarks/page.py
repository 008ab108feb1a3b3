"""Makes docs/benchmarks.md, the table in README.md and the charts from ``results.json``; ``make bench`` ends with it.

The words of the page stand in ``page.md``, with a name in braces where something measured belongs. A number that is missed must
have its reason in ``missed.toml``: without it there is no page.
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
    "scaling": tables.scaling,
    "runs": tables.runs,
    "scale": tables.scale,
    "methods": tables.methods,
}
BESIDE = {  # the first cell of a row of README's table: the peer that it is about
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
    parser.add_argument("--results", type=Path, default=RESULTS, help="[default: benchmarks/results.json]")
    parser.add_argument("--to", type=Path, default=REPOSITORY, help="a folder with docs/ and README.md [default: this one]")
    parser.add_argument("--draft", action="store_true", help="a page also where reasons lack")
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
    print(f"{options.to / 'docs' / 'benchmarks.md'}, README.md, docs/pictures/bench-*.png")


def verdicts(results: Results) -> str:
    """The numbers to hold, as a table."""
    return tables.markdown(["what", "wanted", "measured", ""], [aim.row for aim in aims(results)])


def document(results: Results, *, draft: bool = False) -> str:
    """docs/benchmarks.md.

    Raises:
        SystemExit: a number is missed, and nothing says why.
    """
    reasons = tomllib.loads((HERE / "missed.toml").read_text(encoding="utf-8"))
    missed = [aim for aim in aims(results) if not aim.held and aim.value is not None]
    reasons = dict.fromkeys((aim.key for aim in missed), "nobody said why yet.") | reasons if draft else reasons
    if unsaid := [f"{aim.key!r} ({', '.join(aim.row[:3])})" for aim in missed if aim.key not in reasons]:
        raise SystemExit(f"benchmarks/missed.toml must say why these are missed and what would mend them: {'; '.join(unsaid)}")
    parts = {"aims": verdicts(results), "missed": "".join(f"- **{aim.what}**: {reasons[aim.key].strip()}\n" for aim in missed)}
    for script, table in SCRIPTS.items():
        parts[script] = f"{table(results[script])}\n{measured(results, script)}" if script in results else "Not measured yet.\n"
        parts[f"{script}_chart"] = "".join(
            f"![{words}](pictures/bench-{name}.png)\n" for name, (of, words) in charts.CHARTS.items() if of == script in results
        )
    text = (HERE / "page.md").read_text(encoding="utf-8")
    text = re.sub(r"^\{(\w+)\}\n", lambda found: parts[found[1]], text, flags=re.M)
    return re.sub(r"\n{3,}", "\n\n", text)


def measured(results: Results, script: str) -> str:
    """When, where and with what."""
    found = results[script]
    machine = found["machine"]
    versions = ", ".join(f"{name} {version}" for name, version in found["versions"].items())
    times = [f"{found[what]} {unit}" for what, unit in (("rounds", "rounds"), ("seconds", "s in all")) if what in found]
    return (
        f"*{', '.join([found['when'], *times])}. {machine['cores']} cores of {machine['cpu']}, {machine['gib']} GiB, "
        f"{machine['system']}, Python {machine['python']}; load {machine['load']} at the end. {versions}.*\n"
    )


def beside(results: Results, readme: str) -> str:
    """README.md with the table of others measured anew."""
    if (found := results.get("dispatch")) is None:
        return readme

    def row(match: re.Match[str]) -> str:
        peer = BESIDE[match["name"]]
        noop, sleep = (tables.main_way(found, peer, work, 4, 400) for work in ("noop", "sleep"))
        if noop is None or sleep is None:
            return match[0]
        return f"| {match['name']} | {tables.figure(noop['us'])} | {tables.share(sleep['efficiency'])} |"

    names = "|".join(map(re.escape, BESIDE))
    readme = re.sub(rf"^\| (?P<name>{names}) \| [\d.,]+ \| \.\d+ \|", row, readme, flags=re.M)
    for one in found["rows"]:
        if one["peer"] == "MQTT (stock)" and "steps" in one.get("form", ""):
            readme = re.sub(rf"^\| {BY_STEP} \| [\d.,]+ \|", f"| {BY_STEP} | {tables.figure(one['us'])} |", readme, flags=re.M)
    return readme


if __name__ == "__main__":
    main()
