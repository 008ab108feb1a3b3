"""``zswarm-ot check``: explain an experiment without running it."""

import shlex
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import click
import msgspec
from msgspec.structs import asdict

from zswarm.experiment import Experiment
from zswarm.ot.commands.shared import options
from zswarm.ot.display import tables
from zswarm.plugins import registry
from zswarm.system.format import duration, plural, size
from zswarm.system.text import clean

if TYPE_CHECKING:
    from zswarm.ot.cluster.discovery import Survey
    from zswarm.ot.estimate.dry_run import Explanation
    from zswarm.ot.study.forecast import Forecast

MENU = ("Begin", 2)
# Lines that a study has for all runs together, and those whose numbers are in its table.
WHOLE, TABULATED = ("experiment", "time", "disk"), ("genome", "work")
SHOWN = 6  # texts of one kind that differ between settings


@click.command("check")
@options.experiment_argument
@options.set_option
@click.option(
    "--servers",
    "search",
    is_flag=True,
    help="Search for servers; show which ones match, and why the others do not.",
)
@options.network_options
@options.json_option
def command(
    name: str, overrides: tuple[str, ...], search: bool, as_json: bool, **network: Any
) -> None:
    """Explain an experiment, and find mistakes.

    Shows what is evolved, how much work that is, how long it takes here and on other machines,
    and what is probably a mistake. Only a few trials are played, to time them.

    \b
      zswarm-ot check stadium
      zswarm-ot check my.toml --set optimizer.population=200
      zswarm-ot check my.toml --servers
    """
    from zswarm.ot import build
    from zswarm.ot.cluster import matching
    from zswarm.ot.estimate import dry_run
    from zswarm.ot.study.forecast import forecast
    from zswarm.ot.study.study import checked_plan

    loaded, complete = options.loaded_and_complete(name, overrides, network)
    study, explained = None, None
    with tables.doing("playing a few trials; the first time, kernels are compiled"):
        if complete.study.asks_for_runs():
            _, cells = checked_plan(complete, name, {})
            study = forecast(loaded, complete, cells)
            warnings = study.warnings
        else:
            explained = dry_run.explain(complete, build.build(complete))
            explained.warnings.extend(dry_run.too_large(explained.record_bytes))
            warnings = [*explained.warnings, *explained.unportable]
    survey = _survey(complete) if search else None
    if as_json:
        values: dict[str, Any] = (
            study.for_programs(complete) if study else msgspec.to_builtins(explained)
        )
        if survey is not None:
            choice = matching.choice(complete.cluster)
            values["servers"] = [
                {
                    "server": found.server,
                    "slots": found.offer.capacity if found.offer else 0,
                    "matches": not (reason := found.mismatch(choice)),
                    "reason": reason,
                }
                for found in survey.servers
            ]
        tables.print_json(values)
        return
    if study:
        _show_study(study, complete)
    if explained:
        for about, text in lines(explained, complete):
            tables.entry(about, clean(text))
    matches = None if survey is None else _show_servers(survey, complete)
    for warning in warnings:
        tables.entry("warning", warning, colour="yellow")
    run = shlex.join(["zswarm-ot", "run", name, *_given(overrides, network)])
    tables.line(f"{_verdict(warnings, matches, complete.cluster.servers)}: {clean(run)}")


def _verdict(warnings: list[str], matches: int | None, servers: int | str) -> str:
    """Say whether an experiment can be run, given how many servers match, if that is known."""
    from zswarm.ot.estimate.dry_run import NOTHING_EVOLVES

    if any(text.endswith(NOTHING_EVOLVES) for text in warnings):
        return "when its trials no longer fail"
    if matches is not None and isinstance(servers, int) and matches < servers:
        return f"when {plural(servers - matches, 'more matching server')} can be reached"
    verdict = "the experiment can be run" if warnings else "the experiment is fine"
    return verdict if matches != 0 else f"{verdict}, but only this machine can compute it"


def _given(overrides: tuple[str, ...], network: dict[str, Any]) -> Iterator[str]:
    """Yield the options of ``run`` that mean the same."""
    for override in overrides:
        yield from ("--set", override)
    for name, value in network.items():
        option = name.replace("_", "-")
        if isinstance(value, bool):
            yield f"--{option}" if value else f"--no-{option}"
        else:
            for each in value if isinstance(value, tuple) else filter(None, [value]):
                yield from (f"--{option}", each)


def _show_study(study: "Forecast", complete: Experiment) -> None:
    """Print what the runs of a study have in common, what differs, and the work of all."""
    from zswarm.ot.study import effort_table

    for about, text in study_lines(study, complete):
        tables.entry(about, clean(text))
    if len(study.cells) > 1:
        tables.line("")
        effort_table.show(study.cells)
    tables.entry("in all", effort_table.total(study.cells, complete.study.repeat))
    trials = [one.trial_s for one in study.explained]
    slots = study.explained[0].slots
    text = _time(trials, study.seconds, slots, study.seconds_elsewhere)
    tables.entry("time", text)
    tables.entry("disk", f"about {size(study.record_bytes)}")


def _budget(complete: Experiment) -> str:
    return "".join(
        f", {plural(limit, unit.removesuffix('s'))} in each run"
        for unit, limit in asdict(complete.study.budget).items()
        if limit
    )


def study_lines(study: "Forecast", complete: Experiment) -> Iterator[tuple[str, str]]:
    """Yield what a line is about, and its text: once for all runs, or for the settings it is of."""
    from zswarm.ot.study import forecast

    repeat, seed, cells = complete.study.repeat, complete.seed, study.cells
    times = "once" if repeat == 1 else f"{repeat} times"
    settings, runs = plural(len(cells), "setting"), plural(repeat * len(cells), "run")
    yield "study", f"{settings}, each run {times}: {runs}. All settings are possible"
    seeds = f"seed {seed}" if repeat == 1 else f"seeds {seed} to {seed + repeat - 1}"
    yield "experiment", f"{complete.name}: {seeds}{_budget(complete)}"
    each = [
        dict(lines(one, cell.experiment))
        for cell, one in zip(cells, study.explained, strict=True)
    ]
    if len(cells) > 1:
        each = [
            texts | {"optimizer": one.optimizer}  # its candidates are in the table
            for texts, one in zip(each, study.explained, strict=True)
        ]
    for about in dict.fromkeys(about for texts in each for about in texts):
        found = forecast.by_text(
            cells, [[texts[about]] if about in texts else [] for texts in each]
        )
        if about in WHOLE or (about in TABULATED and len(found) > 1):
            continue
        for number, (text, names) in enumerate(found.items()):
            if number == SHOWN:
                yield "", f"and {len(found) - SHOWN:,} more"
                break
            yield "" if number else about, forecast.for_settings(text, names)


def lines(e: "Explanation", complete: Experiment) -> Iterator[tuple[str, str]]:
    """Yield what a line is about, and its text."""
    yield (
        "experiment",
        f"{e.experiment}: {plural(e.generations, 'generation')}, seed {complete.seed}",
    )
    about = e.about.replace("``", "")
    yield "problem", f"{e.simulator}: {about}" if about else e.simulator
    if e.ranges:
        varied = ", ".join(f"{name} {words}" for name, words in e.ranges.items())
        yield "ranges", f"{varied}: drawn for each trial from its seed"
    agents = (
        f"{e.agents:,}"
        if e.agents == e.most_agents
        else f"{e.agents:,} to {e.most_agents:,}"
    )
    one = e.participants == 1
    genomes = (
        "the same genome" if one else f"{e.participants} genomes that play each other"
    )
    yield "robots", f"{agents}, {'all ' if one else ''}driven by {genomes}"
    nodes = [_named(e.inputs, "input", e.sensors)]
    nodes += [] if e.hidden is None else [plural(e.hidden, "hidden node")]
    nodes += [_named(e.outputs, "output", e.actuators)]
    yield "controller", f"{e.representation}: {', '.join(nodes)}"
    numbers = "" if e.genome_numbers is None else f"{e.genome_numbers:,} numbers, "
    varies = e.genome_bytes is None
    yield (
        "genome",
        numbers + ("its length varies" if varies else f"{e.genome_bytes:,} bytes"),
    )
    yield "fitness", _fitness(e, complete)
    first, later = e.candidates_first_generation, e.candidates_later_generations
    changes = later != first and e.generations > 1
    when = f"the first generation, then {later:,}" if changes else "each generation"
    yield (
        "optimizer",
        f"{e.optimizer}: {first:,} candidates in {when}",
    )
    yield "work", _work(e)
    yield "time", _time([e.trial_s], e.seconds, e.slots, e.seconds_elsewhere)
    yield "disk", f"about {size(e.record_bytes)}"
    yield "result", _result(e)


def _time(trials: list[float], seconds: float, slots: int, elsewhere: float) -> str:
    """Return how long a simulation takes, and all of them here and on other machines."""
    from zswarm.ot.estimate.dry_run import EXAMPLE_SERVERS, EXAMPLE_SLOTS

    ends = list(dict.fromkeys((duration(min(trials)), duration(max(trials)))))
    return (
        f"a simulation takes about {' to '.join(ends)} here; all of them {duration(seconds)} "
        f"on this machine's {plural(slots, 'slot')}, {duration(elsewhere)} on "
        f"{EXAMPLE_SERVERS} such servers with {EXAMPLE_SERVERS * EXAMPLE_SLOTS} slots in all. The "
        "network and the optimizer take additional time"
    )


def _work(e: "Explanation") -> str:
    """Return how many evaluations and simulations a run has."""
    work = f"{e.evaluations:,} evaluations, {e.simulations:,} simulations"
    if e.simulations_expected < e.simulations:
        work += f" at most (with racing about {e.simulations_expected:,})"
    if e.assessment_simulations:
        work += f", and {e.assessment_simulations:,} to assess the champion"
    return work


def _result(e: "Explanation") -> str:
    """Say on which machines the run gives the same."""
    if not e.repeatable:
        return f"differs from run to run: trials of {e.simulator} do not repeat"
    if not e.portable:
        return f"may differ in the last bits between machines, because of optimizer {e.optimizer}"
    if e.unportable:
        lines = plural(len(e.unportable), "line")
        return f"may differ in the last bits between machines: see {lines} of {e.simulator} below"
    parts: dict[registry.Kind, str] = {
        "simulator": e.simulator,
        "representation": e.representation,
        "ranking": e.ranking,
        "optimizer": e.optimizer,
    }
    own = [
        f"{kind} {name}"
        for kind, name in parts.items()
        if name not in registry.BUNDLED[kind]
    ]
    rules = f"; {' and '.join(own)}: if it keeps the rules for own parts" if own else ""
    return f"the same on all machines, bit for bit{rules}"


def _named(count: int, noun: str, names: list[str]) -> str:
    return plural(count, noun) + (f" ({', '.join(names)})" if names else "")


def _fitness(e: "Explanation", complete: Experiment) -> str:
    fixed = complete.problem.seeds == "fixed"
    if e.trials == 1:
        judged = f"one trial, {'the same' if fixed else 'a new one'} in every generation"
    else:
        trials = "the same" if fixed else "new ones"
        judged = f"the mean of {e.trials:,} trials, {trials} in every generation"
    if e.participants > 1:
        games = (
            f"{plural(e.games, 'game')} in the first generation, ranked by {e.ranking}"
        )
        judged = f"{games}; the result of a game is {judged}"
    return judged + (f"; also recorded: {', '.join(e.metrics)}" if e.metrics else "")


def _survey(complete: Experiment) -> "Survey":
    from zswarm.ot.cluster import discovery, matching

    cluster = complete.cluster
    where = (cluster.realm, cluster.connect, cluster.multicast, cluster.through_router)
    reach = options.reach(*where, keys=True)
    requirements = matching.requirements(complete, cluster)
    return discovery.survey(cluster.realm, reach, requirements=requirements, wait_s=1.5)


def _show_servers(survey: "Survey", complete: Experiment) -> int:
    """Print which servers match, and why others do not; return how many match."""
    from zswarm.ot.cluster import matching

    realm, choice = complete.cluster.realm, matching.choice(complete.cluster)
    refusals = {found.server: found.mismatch(choice) for found in survey.servers}
    matching_ones = [found for found in survey.servers if not refusals[found.server]]
    slots = sum(
        found.offer.capacity for found in matching_ones if found.offer is not None
    )
    limit = f", of which it holds at most {choice.max_slots:,}"
    text = (
        f"{len(matching_ones)} of {plural(len(survey.servers), 'server')} in realm {realm}, of the "
        f"same code, with {plural(slots, 'slot')}{limit if 0 < choice.max_slots < slots else ''}"
    )
    tables.entry("servers", text if survey.servers else f"none found in realm {realm}")
    for server, reason in refusals.items():
        if reason:
            tables.entry("", clean(f"{server} is not used: {reason}"))
    for line in survey.findings:
        tables.entry("", clean(line))
    return len(matching_ones)
