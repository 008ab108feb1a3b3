"""``zswarm-ot check``: what an experiment amounts to, without running it."""

import shlex
from typing import TYPE_CHECKING, Any

import click

from zswarm import experiment
from zswarm.experiment import Experiment
from zswarm.ot.commands import suggestions
from zswarm.ot.commands.options import json_option, named, set_option

if TYPE_CHECKING:
    from zswarm.ot.discovery import Found, Survey
    from zswarm.ot.explanation import Explanation
    from zswarm.ot.matching import Choice


@click.command()
@click.argument("name", metavar="EXPERIMENT.toml|EXAMPLE", shell_complete=suggestions.experiments)
@set_option
@click.option("--servers", "look", is_flag=True, help="Look for servers, and say which match and why others do not.")
@json_option
def check(name: str, overrides: tuple[str, ...], look: bool, as_json: bool) -> None:
    """Explain an experiment, and find mistakes.

    Says what is evolved, how much work that is, how long it takes here and on other machines, and what is likely a
    mistake. Nothing is run but some trials, to time them.

    \b
      zswarm-ot check stadium
      zswarm-ot check my.toml --set optimizer.population=200
      zswarm-ot check my.toml --servers
    """  # noqa: D301  click's mark for text that is not to be wrapped
    from zswarm.ot import explanation, matching, terminal
    from zswarm.ot import run as runs
    from zswarm.protocol.codec import clean

    path = experiment.find(name)
    with named(overrides, path):
        complete = experiment.complete(experiment.load(path, overrides), str(path))
    explained = explanation.explain(complete, runs.build(complete))
    survey = _survey(complete) if look else None
    if as_json:
        choice = matching.choice(complete.cluster)
        found = {} if survey is None else {"servers": [_server(server, choice) for server in survey.servers]}
        terminal.print_json({**explanation.as_mapping(explained), **found})
        return
    show(explained, complete)
    if survey is not None:
        _show_servers(survey, complete)
    for warning in explained.warnings:
        terminal.entry("warning", warning, colour="yellow")
    fine = "the experiment can be run" if explained.warnings else "the experiment is fine"
    terminal.line(f"{fine}: {clean(shlex.join(['zswarm-ot', 'run', name, *(w for o in overrides for w in ('--set', o))]))}")


def show(explained: "Explanation", complete: Experiment) -> None:
    """What an experiment amounts to, in words."""
    from zswarm.ot import terminal
    from zswarm.ot.explanation import EXAMPLE_SERVERS, EXAMPLE_SLOTS, in_bytes, in_time
    from zswarm.protocol.codec import clean

    e = explained
    sensors = f" ({', '.join(e.sensors)})" if e.sensors else ""
    actuators = f" ({', '.join(e.actuators)})" if e.actuators else ""
    hidden = f"{terminal.plural(e.hidden, 'hidden node')}, " if e.hidden is not None else ""
    inputs, outputs = terminal.plural(e.inputs, "input") + sensors, terminal.plural(e.outputs, "output") + actuators
    numbers = "" if e.genome_numbers is None else f"{e.genome_numbers:,} numbers, "
    length = "its length varies" if e.genome_bytes is None else f"{e.genome_bytes:,} bytes"
    same = "the same in every generation" if complete.problem.seeds == "fixed" else "new ones in every generation"
    judged = f"one trial, {same.replace('ones', 'one')}" if e.trials == 1 else f"the sum over {e.trials:,} trials, {same}"
    noted = f"; also noted: {', '.join(e.metrics)}" if e.metrics else ""
    first, later = e.candidates_first_generation, e.candidates_later_generations
    then = f", then {later:,}" if later != first and e.generations > 1 else ""
    elsewhere = EXAMPLE_SERVERS * EXAMPLE_SLOTS
    one = e.participants == 1
    agents = f"{e.agents:,}" if e.agents == e.most_agents else f"{e.agents:,} to {e.most_agents:,}"
    varied = ", ".join(f"{name} {words}" for name, words in e.ranges.items())
    driven = f"{agents}, {'all driven by the same genome' if one else f'driven by {e.participants} genomes that play each other'}"
    games = f"{e.games:,} game{'s' if e.games != 1 else ''}"
    score = f"{games} in the first generation, as {e.ranking} has it; the result of a game is {judged}"
    result = "the same on all machines, bit for bit" if e.portable else "may differ in the last bits from machine to machine"
    study = complete.study
    settings = terminal.plural(len(study.settings()), "setting")
    if e.runs > 1:
        repeated = f"{settings}, each run {study.repeat} times: {e.runs:,} runs. What follows is of one run, as the file has it"
        terminal.entry("study", repeated)
    for about, text in (
        ("experiment", f"{e.experiment}: {terminal.plural(e.generations, 'generation')}, seed {complete.seed}"),
        ("problem", f"{e.simulator}: {e.about}" if e.about else e.simulator),
        *([("ranges", f"{varied}: drawn for each trial from its seed")] if varied else []),
        ("robots", driven),
        ("controller", f"{e.representation}: {inputs}, {hidden}{outputs}"),
        ("genome", numbers + length),
        ("fitness", (judged if e.participants == 1 else score) + noted),
        ("optimizer", f"{e.optimizer}: {first:,} candidates in the first generation{then}"),
        ("work", f"{e.evaluations:,} evaluations, {e.simulations:,} simulations"),
        (
            "time",
            f"a simulation takes about {in_time(e.trial_s)} here; all of them {in_time(e.seconds)} on this machine's "
            f"{terminal.plural(e.slots, 'slot')}, {in_time(e.seconds_elsewhere)} on {EXAMPLE_SERVERS} such servers with "
            f"{elsewhere} slots in all. The network and the optimizer come on top",
        ),
        ("disk", f"about {in_bytes(e.record_bytes)}"),
        ("result", result),
    ):
        terminal.entry(about, clean(text))


def _survey(complete: Experiment) -> "Survey":
    from zswarm.ot import discovery, matching
    from zswarm.security import keyring
    from zswarm.session import Reach

    cluster = complete.cluster
    reach = Reach(cluster.connect, cluster.multicast, cluster.through_router, keyring.installed("ot"))
    return discovery.survey(cluster.realm, reach, requirements=matching.requirements(complete, cluster), wait_s=1.5)


def _server(found: "Found", choice: "Choice") -> dict[str, Any]:
    reason, slots = found.mismatch(choice), found.offer.capacity if found.offer else 0
    return {"server": found.server, "slots": slots, "matches": not reason, "reason": reason}


def _show_servers(survey: "Survey", complete: Experiment) -> None:
    from zswarm.ot import matching, terminal
    from zswarm.protocol.codec import clean

    realm, choice = complete.cluster.realm, matching.choice(complete.cluster)
    offers = [found.offer for found in survey.servers if found.offer is not None and not found.mismatch(choice)]
    slots = sum(offer.capacity for offer in offers)
    if survey.servers:
        held = f", of which it holds {choice.max_slots:,} at most" if 0 < choice.max_slots < slots else ""
        count = f"{len(offers)} of {terminal.plural(len(survey.servers), 'server')}"
        terminal.entry("servers", f"{count} in realm {realm} can evaluate it, with {terminal.plural(slots, 'slot')}{held}")
    else:
        terminal.entry("servers", f"none found in realm {realm}")
    for found in survey.servers:
        if why := found.mismatch(choice):
            terminal.entry("", clean(f"{found.server} is not used: {why}"))
    for line in survey.findings:
        terminal.entry("", clean(line))
