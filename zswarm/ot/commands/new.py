"""``zswarm-ot new``: begin a package of your own."""

import keyword
import re
import shlex
from pathlib import Path

import click

from zswarm import experiment
from zswarm.errors import ConfigError
from zswarm.ot.commands.shared import options
from zswarm.ot.display import tables
from zswarm.plugins import registry

MENU = ("Begin", 5)
EXAMPLE = "my-simulator"  # the example that is copied; its folder has _ in place of -
COMPILED = (
    "compiled"  # its subfolder with what a compiled simulator has instead, or besides
)
FILES = (".md", ".py", ".toml")


@click.group("new")
def command() -> None:
    """Create a plug-in package."""


@command.command()
@click.argument("name")
@click.option("--compiled", is_flag=True, help="One whose trials numba compiles.")
def simulator(name: str, compiled: bool) -> None:
    """Begin a simulator: a package with its tests and an experiment, in a new folder.

    It is complete and evolves; change it into yours.

    \b
      zswarm-ot new simulator lost-robots
      cd lost-robots
      pip install -e .
      zswarm-ot run lost-robots.toml
    """
    files = skeleton(name, compiled=compiled)
    folder = Path(name)
    with options.writing(folder, "give another name, or go to another folder"):
        folder.mkdir()
        for file, text in files.items():
            folder.joinpath(file).write_text(text, encoding="utf-8")
    tables.line(f"{folder}: a simulator that can be evolved; change {module_of(name)}.py")
    steps = [f"cd {shlex.quote(name)}", "pip install -e . pytest", "python -m pytest"]
    steps += [f"zswarm-ot {verb} {name}.toml" for verb in ("check", "run")]
    steps.append(f"zswarm-ot replay runs/{name}")
    tables.line("next:  " + "\n       ".join(steps))


def skeleton(name: str, *, compiled: bool = False) -> dict[str, str]:
    """Return the files of a new simulator: those of the example, renamed.

    Args:
        compiled: take the files of the compiled example in place of those of the same name.

    Raises:
        ConfigError: a simulator cannot have this name.
    """
    _check(name)
    folder = experiment.examples_folder() / module_of(EXAMPLE)
    example = {
        path.name: path.read_text(encoding="utf-8")
        for part in (folder, folder / COMPILED)[: 1 + compiled]
        for path in sorted(part.iterdir())
        if path.suffix in FILES
    }
    made = class_of(name)
    if name != EXAMPLE and any(
        re.search(rf"\b{made}\b", text) for text in example.values()
    ):
        raise ConfigError(
            f"{name}: its class would be {made}, a word that simulators already use; give another "
            "name"
        )

    def renamed(text: str) -> str:
        for spelled in (str, module_of, class_of):
            text = text.replace(spelled(EXAMPLE), spelled(name))
        return text

    return {renamed(file): renamed(text) for file, text in example.items()}


def module_of(name: str) -> str:
    """Return the Python module of a simulator."""
    return name.replace("-", "_")


def class_of(name: str) -> str:
    """Return the class of a simulator."""
    return "".join(word.capitalize() for word in name.split("-"))


def _check(name: str) -> None:
    import importlib.util

    module = module_of(name)
    if not re.fullmatch(r"[a-z][a-z0-9]*(-[a-z0-9]+)*", name) or len(name) > 63:
        raise ConfigError(
            f"{name!r}: expected a name of small letters, digits and - that begins with a letter, "
            "such as lost-robots"
        )
    if name in registry.names("simulator"):
        raise ConfigError(
            f"{name}: there is a simulator of that name (zswarm-ot list); give another name"
        )
    if keyword.iskeyword(module) or importlib.util.find_spec(module) is not None:
        raise ConfigError(
            f"{name}: Python already has a module {module}; give another name, such as {name}-swarm"
        )
