"""Write docs/paper.md from ``results.json`` and the text in ``page.md``."""

import re
from pathlib import Path
from typing import Any

import tables

from paper import charts, findings
from paper.claims import claims as all_claims
from paper.equations import coefficients, crossing
from paper.findings import Results, ms, table_i
from paper.names import FILES, LOCAL, NODELAY, STOCK, ZENOH
from zswarm.ot.estimate.cost_model import (
    TABLE_I,
    TABLE_I_EVALUATIONS,
    TABLE_I_GENERATIONS,
    TABLE_I_POPULATION,
    Constants,
    Plan,
    blob,
    expected_s,
    useful_slots,
)
from zswarm.ot.estimate.cost_model import internal as broker

HERE = Path(__file__).resolve().parent
VERDICTS = {True: "agrees", False: "**does not agree**"}
AGENTS = (1, 2, 4, 8, 16, 32)
FIGURE_4 = Plan(generations=4, population=4, steps=50, agents=8)


def document(results: Results) -> str:
    """Return docs/paper.md."""
    claims = all_claims(results)
    table = [
        (claim.says, claim.paper, claim.here, VERDICTS[claim.agrees]) for claim in claims
    ]
    parts = {
        "where": _where(results),
        "claims": tables.markdown(["claim", "paper", "here", ""], table),
        "why": "".join(
            f"- **{claim.says}**: {claim.why}\n" for claim in claims if not claim.agrees
        ),
        "designs": _designs(results),
        "table": _table(results),
        "messages": _messages(results),
        "fits": _fits(results),
        "equations": _equations(results),
        "crossings": _crossings(results),
        "scaling": _servers(results, "scaling"),
        "slower": _slower(results),
        "late": _late(results),
        "behind": _behind(results),
        "crowded": _servers(results, "crowded"),
        "model": _model(),
        **{
            f"{name}_chart": f"![{words}](pictures/paper-{name}.png)\n"
            for name, words in charts.CHARTS.items()
        },
    }
    text = (HERE / "page.md").read_text(encoding="utf-8")
    text = re.sub(r"^\{(\w+)\}\n", lambda found: parts[found[1]], text, flags=re.M)
    text = re.sub(r"\{(\w+)\}", lambda found: _words(results)[found[1]], text)
    return re.sub(r"\n{3,}", "\n\n", text)


def _words(results: Results) -> dict[str, str]:
    """Return numbers for sentences: the plan as measured."""

    def values(part: str, key: str) -> list[Any]:
        return sorted({row[key] for row in findings.rows(results, part=part)})

    def listed(part: str, key: str) -> str:
        return ", ".join(str(each) for each in values(part, key))

    steps = {
        world: findings.median(results, "steps", part="designs", world=world)
        for world in ("emergency-exit", "minisim")
    }
    histories = {
        (row["world"], row["history"]) for row in findings.rows(results, part="designs")
    }
    two = useful_slots(broker, FIGURE_4, TABLE_I)
    never = all(
        crossing(table_i(agents), TABLE_I, against=blob) == 1 for agents in AGENTS
    )
    return {
        "alike": f"{findings.ALIKE:g}",
        "two": f"{findings.TWO:g}",
        "enough": f"{findings.ENOUGH:g}",
        "drastic": f"{findings.DRASTIC:g}",
        "same": "All designs give"
        if len(histories) == len(steps)
        else "Not all designs give",
        "model_servers": f"{two} server{'s' if two > 1 else ''}",
        "never": "is never faster" if never else "is sometimes faster",
        "designs_steps": f"{steps['emergency-exit']:g}",
        "crowd_steps": f"{steps['minisim']:g}",
        "grid_agents": listed("grid", "agents"),
        "grid_steps": listed("grid", "steps"),
        "grid_ms": f"{1e3 * values('grid', 'step_s')[0]:g}",
        "scaling_ms": f"{1e3 * values('scaling', 'step_s')[0]:g}",
        "crowded_ms": f"{1e3 * values('crowded', 'step_s')[0]:g}",
        "crowded_trials": listed("crowded", "trials"),
        "cores": str(results["machine"]["cores"]),
    }


def _where(results: Results) -> str:
    machine = results["machine"]
    versions = ", ".join(
        f"{name} {version}" for name, version in results["versions"].items()
    )
    missing = "".join(
        f" {name} was not measured: {why}." for name, why in results["missing"].items()
    )
    return (
        f"*{results['when']}, {results['seconds'] / 60:.0f} minutes. {machine['cores']} cores of "
        f"{machine['cpu']}, "
        f"{machine['gib']} GiB, {machine['system']}, Python {machine['python']}; load "
        f"{machine['load']} at the end. "
        f"{versions}.{missing} The paper's machine: two Xeon X5675 at 3.07 GHz, 12 cores, 16 GB, "
        "Debian 9.*\n"
    )


def _designs(results: Results) -> str:
    decisions = {
        world: findings.rows(results, part="designs", design=LOCAL, world=world)[0]
        for world in ("emergency-exit", "minisim")
    }
    lines = []
    for name in findings.designs(results):
        cells = []
        for world, alone in decisions.items():
            seconds = findings.design_s(results, name, world)
            counted = _counted(results, name, world, alone)
            cells += ["" if seconds != seconds else _seconds(seconds), counted]
        lines.append((name, *cells))
    return tables.markdown(
        ["", "emergency exit, s", "messages", "minisim, s", "messages"], lines
    )


def _counted(results: Results, name: str, world: str, alone: dict[str, Any]) -> str:
    """Return messages between optimizer and simulators, without those of the start."""
    if name == ZENOH["turn"]:
        return f"{2 * alone['turns']:,}"
    if name == ZENOH["agent"]:
        return f"{2 * alone['decisions']:,}"
    found = (
        findings.median(results, "messages", part="designs", design=name, world=world)
        if name in (STOCK, NODELAY)
        else None
    )
    return "" if found is None else f"{found:,.0f}"


def _table(results: Results) -> str:
    here, nodelay = (
        findings.constants(results, STOCK),
        findings.constants(results, NODELAY),
    )
    gcc = findings.median(results, "compile_s", part="designs", design=FILES["cc"])
    size = findings.rows(results, part="designs")[0]
    gcc_words = (
        ""
        if gcc is None or findings.build(results) == FILES["cc"]
        else f"; gcc alone {ms(gcc)}"
    )
    lines = [
        (
            "n_gen",
            f"{TABLE_I_GENERATIONS}",
            f"{size['generations']}; {TABLE_I_GENERATIONS} where t_evo is measured",
        ),
        (
            "n_pop",
            f"{TABLE_I_POPULATION}",
            f"{size['population']}; {TABLE_I_POPULATION} where t_evo is measured",
        ),
        ("n_eval", f"{TABLE_I_EVALUATIONS}", f"{size['trials']}"),
        ("t_evo", ms(TABLE_I.evolve_s), ms(here.evolve_s)),
        (
            "t_msg",
            ms(TABLE_I.message_s),
            f"{ms(here.message_s)}; with TCP_NODELAY {ms(nodelay.message_s)}",
        ),
        ("t_export", ms(TABLE_I.export_s), ms(here.export_s)),
        (
            "t_compile",
            ms(TABLE_I.compile_s),
            f"{ms(here.compile_s)} ({findings.build(results)}){gcc_words}",
        ),
        ("t_fitness", ms(TABLE_I.fitness_s), ms(here.fitness_s)),
        ("t_step", ms(TABLE_I.step_s), f"{ms(here.step_s)}, as set"),
    ]
    return tables.markdown(["", "paper", "here"], lines)


def _messages(results: Results) -> str:
    agents = sorted({row["agents"] for row in findings.rows(results, part="messages")})
    lines = [
        (design, *(_us(findings.message_s(results, design, each)) for each in agents))
        for design in (STOCK, NODELAY, ZENOH["turn"], ZENOH["agent"])
    ]
    return tables.markdown(["us", *(charts.counted(each) for each in agents)], lines)


def _fits(results: Results) -> str:
    lines = []
    for design in (STOCK, NODELAY, FILES["cc"]):
        found = findings.fit(results, design)
        lines.append(
            (
                design,
                ms(found.a),
                ms(found.b),
                f"{1e3 * found.c:.3f} ms",
                f"{found.r2:.4f}",
            )
        )
    return tables.markdown(
        ["", "each simulation", "each step", "each step and agent", "R^2"], lines
    )


def _equations(results: Results) -> str:
    named = {
        "paper": TABLE_I,
        "here": findings.constants(results, STOCK),
        "here, TCP_NODELAY": findings.constants(results, NODELAY),
    }
    lines = []
    for name, constants in named.items():
        found = coefficients(table_i(), constants)
        steps = f"{found.messages:g} + steps ({found.step:.3g} + agents)"
        inside = f"{found.base_s:.3g} s (1 + {found.internal:.4g} / n ({steps}))"
        outside = f"{found.base_s:.3g} s (1 + {found.external:.5g} / n ({found.files:.4g} + steps))"
        lines.append((name, inside, outside))
    return tables.markdown(["", "t_opt,int (9)", "t_opt,ext (10)"], lines)


def _crossings(results: Results) -> str:
    named: dict[str, Constants] = {"Table I": TABLE_I}
    named |= {
        f"measured, {design}": findings.constants(results, design)
        for design in (STOCK, NODELAY)
    }
    lines = []
    for name, constants in named.items():
        found = [crossing(table_i(agents), constants) for agents in AGENTS]
        lines.append(
            (name, *("never" if each is None else f"{each:,}" for each in found))
        )
    parameters = [crossing(table_i(agents), TABLE_I, against=blob) for agents in AGENTS]
    lines.append(
        (
            "Table I, compared with parameters in a message",
            *(str(each) for each in parameters),
        )
    )
    return tables.markdown(["", *(charts.counted(each) for each in AGENTS)], lines)


def _servers(results: Results, part: str) -> str:
    found = findings.rows(results, part=part)
    servers = sorted({row["servers"] for row in found})
    lines = []
    for steps in sorted({row["steps"] for row in found}):
        for design in dict.fromkeys(row["design"] for row in found):
            by_servers = findings.times(results, part, design, steps)
            lines.append(
                (
                    f"{steps}",
                    design,
                    *(f"{by_servers[count]['s']:.2f}" for count in servers),
                )
            )
        one = next(row for row in found if row["steps"] == steps)
        lines.append(
            (
                f"{steps}",
                "steps only",
                *(f"{findings.ideal_s(one, count):.2f}" for count in servers),
            )
        )
    return tables.markdown(
        ["steps", "s, by servers", *(str(count) for count in servers)], lines
    )


def _slower(results: Results) -> str:
    """Explain why a message over Zenoh takes longer than through the broker, if it does."""
    agents = max(row["agents"] for row in findings.rows(results, part="messages"))
    broker_s, zenoh_s = (
        findings.message_s(results, design, agents)
        for design in (NODELAY, ZENOH["agent"])
    )
    if zenoh_s <= findings.TWO * broker_s:
        return ""
    return (
        f"With {agents} agents, a message by agent over Zenoh takes {findings.us(zenoh_s)}, and a "
        "message through the broker with TCP_NODELAY\n"
        f"{findings.us(broker_s)}. There are two reasons: the server forwards each question and "
        "each answer between the network and the slot's\n"
        "process, and a slot waits for each answer before it asks for the next agent, while the "
        "broker's simulator sends the messages of all\n"
        "agents of a turn at once.\n"
    )


def _late(results: Results) -> str:
    """Explain zswarm's extra round, if there is one."""
    by_servers = findings.times(
        results, "scaling", ZENOH["blob"], findings.longest(results, "scaling")
    )
    taken = {
        servers: row["s"] / (row["steps"] * row["step_s"])
        for servers, row in by_servers.items()
    }
    needs = {
        servers: findings.rounds(row, servers) for servers, row in by_servers.items()
    }
    servers = next(
        (servers for servers, took in taken.items() if took > needs[servers] + 0.5), 0
    )
    if not servers:
        return ""
    took, needed = taken[servers], needs[servers]
    return (
        f"With {servers} servers, zswarm takes {took:.0f} rounds of simulations, although "
        f"{needed} are enough. Its run begins with the first ready\n"
        "server, and each server holds a second candidate in addition to the one that it "
        "simulates. So the first generation is sent before\n"
        "the other servers are ready. This happens once in a run.\n"
    )


def _behind(results: Results) -> str:
    """Name the fastest design with the most servers, if it is not zswarm."""
    steps, most = (
        findings.longest(results, "crowded"),
        max(row["servers"] for row in findings.rows(results, part="crowded")),
    )
    times = {
        row["design"]: row["s"]
        for row in findings.rows(results, part="crowded", steps=steps, servers=most)
    }
    ours, fastest = ZENOH["blob"], min(times, key=times.__getitem__)
    if fastest == ours:
        return ""
    return (
        f"With {most} servers the fastest design is: {fastest}, {times[fastest]:.2f} s; "
        f"{ours} take {times[ours]:.2f} s,\n"
        "which includes the start of the other servers after the first, and the end of the run.\n"
    )


def _model() -> str:
    plan = FIGURE_4
    servers = (1, 2, 4, 8, 16)
    lines = []
    for name, way in (("broker", broker), ("parameters in a message", blob)):
        found = [f"{expected_s(way, plan, TABLE_I, count):.1f}" for count in servers]
        lines.append((name, *found, str(useful_slots(way, plan, TABLE_I))))
    many = useful_slots(blob, table_i(plan.agents, plan.steps), TABLE_I)
    lines += [
        (
            f"parameters, Table I's {TABLE_I_POPULATION} candidates",
            *("" for _ in servers),
            str(many),
        )
    ]
    return tables.markdown(
        [
            "Table I, 8 agents, 50 steps: s",
            *(str(count) for count in servers),
            "useful servers",
        ],
        lines,
    )


def _seconds(seconds: float) -> str:
    return f"{seconds:.3f}" if seconds < 1 else f"{seconds:.2f}"


def _us(seconds: float) -> str:
    return f"{1e6 * seconds:,.0f}"
