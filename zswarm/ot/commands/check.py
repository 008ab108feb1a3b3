"""``zswarm-ot check``: explain an experiment without running it."""

import shlex
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import click
import msgspec

from zswarm.experiment import Experiment
from zswarm.ot.commands.shared import options
from zswarm.ot.display import tables
from zswarm.plugins import registry
from zswarm.system.format import duration, plural, size
from zswarm.system.text import clean

if TYPE_CHECKING:
    from zswarm.ot.cluster.discovery import Survey
    from zswarm.ot.estimate.dry_run import Explanation
    from zswarm.ot.study.effort import Cell

MENU = ("Begin", 2)


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
    from zswarm.ot.study import effort, effort_table
    from zswarm.ot.study.study import checked_plan

    loaded, complete = options.loaded_and_complete(name, overrides, network)
    cells: list[Cell] = []
    if complete.study.runs() > 1 or complete.study.varies():
        _, cells = checked_plan(complete, name, {})
    with tables.doing("playing a few trials; the first time, kernels are compiled"):
        explained = dry_run.explain(complete, build.build(complete))
    explained.warnings.extend(effort.warnings(loaded, cells) if cells else ())
    survey = _survey(complete) if search else None
    if as_json:
        values: dict[str, Any] = msgspec.to_builtins(explained)
        if cells:
            values["settings"] = effort_table.as_objects(cells)
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
    for about, text in lines(explained, complete):
        tables.entry(about, clean(text))
    if cells:
        _show_study(cells, complete, explained)
    matches = None if survey is None else _show_servers(survey, complete)
    warnings = [*explained.warnings, *explained.unportable]
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


def _show_study(cells: "list[Cell]", complete: Experiment, e: "Explanation") -> None:
    """Print the settings of a study, and the work and time of all its runs."""
    from zswarm.ot.study import effort_table

    tables.line("")
    effort_table.show(cells)
    repeat = complete.study.repeat
    each = [cell.effort for cell in cells]
    simulations = repeat * sum(
        one.simulations + one.assessment_simulations for one in each
    )
    here = duration(simulations * e.trial_s / e.slots)
    tables.entry("in all", f"{effort_table.total(cells, repeat)}; about {here} here")


def lines(e: "Explanation", complete: Experiment) -> Iterator[tuple[str, str]]:
    """Yield what a line is about, and its text."""
    from zswarm.ot.estimate.dry_run import EXAMPLE_SERVERS, EXAMPLE_SLOTS

    if e.runs > 1:
        settings = plural(complete.study.count(), "setting")
        repeats = f"{settings}, each run {complete.study.repeat} times: {e.runs:,} runs"
        about = "All settings are possible. First one run, as the file has it, then each setting"
        yield "study", f"{repeats}. {about}"
    yield (
        "experiment",
        f"{e.experiment}: {plural(e.generations, 'generation')}, seed {complete.seed}",
    )
    yield "problem", f"{e.simulator}: {e.about}" if e.about else e.simulator
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
    then = f", then {later:,}" if later != first and e.generations > 1 else ""
    yield (
        "optimizer",
        f"{e.optimizer}: {first:,} candidates in the first generation{then}",
    )
    yield "work", _work(e)
    yield (
        "time",
        f"a simulation takes about {duration(e.trial_s)} here; all of them {duration(e.seconds)} "
        f"on this machine's {plural(e.slots, 'slot')}, {duration(e.seconds_elsewhere)} on "
        f"{EXAMPLE_SERVERS} such servers with {EXAMPLE_SERVERS * EXAMPLE_SLOTS} slots in all. The "
        "network and the optimizer take additional time",
    )
    yield "disk", f"about {size(e.record_bytes)}"
    yield "result", _result(e)


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
        return "may differ in the last bits between machines"
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
