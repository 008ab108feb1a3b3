"""``zswarm-ot completion``: what a shell needs to complete commands, options and names."""

import click
from click.shell_completion import get_completion_class

SHELLS = ("bash", "zsh", "fish")
PROGRAMS = ("zswarm-ot", "zswarm-ss", "zswarm-router", "zswarm-keys")


@click.command()
@click.argument("shell", type=click.Choice(SHELLS), metavar="bash|zsh|fish")
def completion(shell: str) -> None:
    """Print a script for the shell's completion.

    Commands, options, examples and runs are completed, of all four programs.

    \b
      zswarm-ot completion bash >> ~/.bashrc
      zswarm-ot completion zsh >> ~/.zshrc
      zswarm-ot completion fish > ~/.config/fish/conf.d/zswarm.fish

    Then open a new terminal. In zsh, compinit comes before it.
    """  # noqa: D301  click's mark for text that is not to be wrapped
    made = get_completion_class(shell)
    assert made is not None  # noqa: S101  click has all three
    for program in PROGRAMS:
        variable = f"_{program.replace('-', '_').upper()}_COMPLETE"
        click.echo(made(click.Command(program), {}, program, variable).source().strip() + "\n")
