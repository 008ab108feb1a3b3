"""``zswarm-ot completion``: print what a shell needs to complete commands, options and names."""

import click
from click.shell_completion import get_completion_class

MENU = ("Shell", 1)
PROGRAMS = ("zswarm-ot", "zswarm-ss", "zswarm-router", "zswarm-keys")


@click.command("completion")
@click.argument(
    "shell", type=click.Choice(["bash", "zsh", "fish"]), metavar="bash|zsh|fish"
)
def command(shell: str) -> None:
    """Print a completion script for a shell.

    It completes commands, options, examples and runs, for all four programs.

    \b
      zswarm-ot completion bash >> ~/.bashrc
      zswarm-ot completion zsh >> ~/.zshrc
      zswarm-ot completion fish > ~/.config/fish/conf.d/zswarm.fish

    Then open a new terminal. In zsh, compinit must come first.
    """
    made = get_completion_class(shell)
    assert made is not None  # noqa: S101  click has all three
    for program in PROGRAMS:
        variable = f"_{program.replace('-', '_').upper()}_COMPLETE"
        click.echo(
            made(click.Command(program), {}, program, variable).source().strip() + "\n"
        )
