"""Groups of commands whose errors name the command that was called."""

from typing import Any

import click


class Group(click.Group):
    """Name the command also where an option lacks its value, as click does in other errors."""

    def invoke(self, ctx: click.Context) -> Any:
        """Call the command; name it in an error that names none."""
        try:
            return super().invoke(ctx)
        except click.UsageError as error:
            name = ctx.invoked_subcommand
            if error.ctx is None and name and (called := self.get_command(ctx, name)):
                error.ctx = click.Context(called, info_name=name, parent=ctx)
            raise
