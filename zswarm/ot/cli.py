"""The command ``zswarm-ot``: its commands, and how errors end it."""

import os
import sqlite3
import sys

import click

from zswarm import screen
from zswarm.errors import ConfigError, NoServers, ZswarmError
from zswarm.ot.commands.check import check
from zswarm.ot.commands.compare import compare
from zswarm.ot.commands.completion import completion
from zswarm.ot.commands.dashboard import dashboard
from zswarm.ot.commands.describe import describe
from zswarm.ot.commands.doctor import doctor
from zswarm.ot.commands.evaluate import evaluate
from zswarm.ot.commands.export import export
from zswarm.ot.commands.import_ import import_
from zswarm.ot.commands.init import init
from zswarm.ot.commands.list import list_
from zswarm.ot.commands.menu import Menu
from zswarm.ot.commands.new import new
from zswarm.ot.commands.plot import plot
from zswarm.ot.commands.replay import replay
from zswarm.ot.commands.report import report
from zswarm.ot.commands.run import resume, run
from zswarm.ot.commands.servers import servers
from zswarm.ot.exits import EXIT_FAILED, EXIT_INTERRUPTED, EXIT_MISTAKE, EXIT_NO_SERVERS


@click.group(cls=Menu, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="zswarm", prog_name="zswarm-ot")
def command() -> None:
    """Evolve swarm-robot controllers on this machine and on every zswarm-ss server of the network.

    \b
    A first run, and one of your own:
      zswarm-ot run stadium
      zswarm-ot init my.toml
      zswarm-ot check my.toml
      zswarm-ot run my.toml

    Every command has --help.
    """  # noqa: D301  click's mark for text that is not to be wrapped


for _command in (
    init,
    check,
    describe,
    new,
    run,
    resume,
    evaluate,
    plot,
    compare,
    replay,
    export,
    report,
    dashboard,
    list_,
    servers,
    doctor,
    import_,
    completion,
):
    command.add_command(_command)


def main() -> None:
    """Run a command; errors that are the user's to mend end in one line."""
    screen.prepare()
    try:
        command.main(standalone_mode=False)
    except (click.exceptions.Abort, KeyboardInterrupt):
        sys.exit(EXIT_INTERRUPTED)
    except BrokenPipeError:  # whoever read the output has enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(EXIT_FAILED)
    except click.ClickException as error:
        error.show()
        sys.exit(error.exit_code)
    except ConfigError as error:
        _complain(error)
        sys.exit(EXIT_MISTAKE)
    except NoServers as error:
        _complain(error, "; start zswarm-ss on the machines. What is wrong is told by: zswarm-ot doctor (docs/network.md)")
        sys.exit(EXIT_NO_SERVERS)
    except (ZswarmError, sqlite3.Error, OSError) as error:  # the last two: a full disk, a folder that was deleted
        _complain(error)
        sys.exit(EXIT_FAILED)


def _complain(error: Exception, more: str = "") -> None:
    """The reason, and below it how to go on."""
    click.echo("\n".join([f"zswarm-ot: {error}{more}", *getattr(error, "__notes__", [])]), err=True)
