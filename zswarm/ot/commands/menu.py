"""The list of commands that ``zswarm-ot --help`` shows: in the order in which a newcomer needs them."""

import click

SECTIONS = {
    "Begin": ("init", "check", "describe", "new", "doctor"),
    "Evolve": ("run", "resume", "servers"),
    "Results": ("list", "dashboard", "evaluate", "replay", "export", "report", "plot", "compare", "import"),
    "Shell": ("completion",),
}
LONGEST = 200  # characters of a command's first sentence; the list folds it


class Menu(click.Group):
    """Commands in sections; one that is in none comes last."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002
        """In the order of the sections."""
        known = [name for names in SECTIONS.values() for name in names if name in self.commands]
        return known + sorted(set(self.commands) - set(known))

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """A list for each section."""
        left = self.list_commands(ctx)
        for title, names in (*SECTIONS.items(), ("Other commands", tuple(left))):
            rows = [(name, self.commands[name].get_short_help_str(LONGEST)) for name in names if name in left]
            left = [name for name in left if name not in names]
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows)
