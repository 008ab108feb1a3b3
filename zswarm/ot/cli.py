"""The command ``zswarm-ot``: find its commands by their modules, and turn errors into one line."""

import importlib
import os
import pkgutil
import sqlite3
import sys
from itertools import groupby
from typing import Any

import click

from zswarm.errors import ConfigError, NoServers, ZswarmError
from zswarm.ot import commands
from zswarm.ot.commands.shared.exits import (
    EXIT_FAILED,
    EXIT_INTERRUPTED,
    EXIT_MISTAKE,
    EXIT_NO_SERVERS,
)
from zswarm.system import program
from zswarm.system.groups import Group
from zswarm.system.version import VERSION

LONGEST = 200  # characters of a command's first sentence in the list, which folds it


class Commands(Group):
    """The modules of ``zswarm.ot.commands``, each of which is imported when its command is used."""

    def __init__(self, **more: Any) -> None:
        super().__init__(**more)
        names = [module.name for module in pkgutil.iter_modules(commands.__path__)]
        self._modules = {name.rstrip("_"): name for name in names if name != "shared"}

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002
        """Return the names of all commands."""
        return sorted(self._modules)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: ARG002
        """Import a command."""
        return self._module(cmd_name).command if cmd_name in self._modules else None

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Import the command that is called; suggest another one if its name is unknown."""
        self.commands = dict.fromkeys(self._modules, self)  # their names are suggested
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:  # noqa: ARG002
        """List the commands by section, in the order in which a newcomer needs them."""
        menu = sorted((*self._module(name).MENU, name) for name in self._modules)
        for section, entries in groupby(menu, key=lambda entry: entry[0]):
            with formatter.section(section):
                formatter.write_dl(
                    [
                        (name, self._module(name).command.get_short_help_str(LONGEST))
                        for _, _, name in entries
                    ]
                )

    def _module(self, name: str) -> Any:
        return importlib.import_module(f"{commands.__name__}.{self._modules[name]}")


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(VERSION, prog_name="zswarm-ot")
def command() -> None:
    """Evolve swarm-robot controllers on this machine and on all zswarm-ss servers of the network.

    \b
    A first run, and one of your own:
      zswarm-ot run stadium
      zswarm-ot init my.toml
      zswarm-ot check my.toml
      zswarm-ot run my.toml

    Every command has --help.
    """


def main() -> None:
    """Run the program."""
    program.run(_run)


def _run() -> None:
    """Run a command; errors that the user can fix end in one line."""
    try:
        command.main(standalone_mode=False)
    except (click.exceptions.Abort, KeyboardInterrupt):
        sys.exit(EXIT_INTERRUPTED)
    except BrokenPipeError:  # the reader of the output has enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(EXIT_FAILED)
    except click.ClickException as error:
        program.refuse(error)
    except ConfigError as error:
        _exit(error, EXIT_MISTAKE)
    except NoServers as error:
        remedy = "start zswarm-ss on the machines; zswarm-ot doctor finds faults (docs/network.md)"
        _exit(error, EXIT_NO_SERVERS, f"; {remedy}")
    # The last two: a full disk, or a folder that was deleted.
    except (ZswarmError, sqlite3.Error, OSError) as error:
        _exit(error, EXIT_FAILED)


def _exit(error: Exception, code: int, more: str = "") -> None:
    """Print the reason, and below it how to continue."""
    notes = getattr(error, "__notes__", [])
    click.echo("\n".join([f"zswarm-ot: {error}{more}", *notes]), err=True)
    sys.exit(code)
