"""``zswarm-ot new``: the beginning of a package of one's own."""

import keyword
import re
import shlex
from pathlib import Path

import click

from zswarm import experiment, plugins
from zswarm.errors import ConfigError

EXAMPLE = "my-simulator"  # of the example whose files these are, in its folder of that name with _
FILES = (".md", ".py", ".toml")


@click.group()
def new() -> None:
    """Begin a package of your own."""


@new.command()
@click.argument("name")
def simulator(name: str) -> None:
    """Begin a simulator: a package with its test and an experiment, in a new folder.

    It is whole, and evolves; change it into yours.

    \b
      zswarm-ot new simulator lost-robots
      cd lost-robots
      pip install -e .
      zswarm-ot run lost-robots.toml
    """  # noqa: D301  click's mark for text that is not to be wrapped
    from zswarm.ot import terminal

    files = skeleton(name)
    folder = Path(name)
    try:
        folder.mkdir()
        for file, text in files.items():
            folder.joinpath(file).write_text(text, encoding="utf-8")
    except FileExistsError:
        raise ConfigError(f"{folder}: is there already; give another name, or go to another folder") from None
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be written: {error.strerror}") from None
    terminal.line(f"{folder}: a simulator that can be evolved, in {module_of(name)}.py; change it into yours")
    steps = [f"cd {shlex.quote(name)}", "pip install -e .", "python -m pytest"]
    steps += [f"zswarm-ot {command} {name}.toml" for command in ("check", "run")]
    terminal.line("\n".join(f"{'next:' if step is steps[0] else '':7}{step}" for step in steps))


def skeleton(name: str) -> dict[str, str]:
    """The files of a new simulator: those of the example, with its name.

    Raises:
        ConfigError: there can be no simulator of that name.
    """
    _check(name)
    folder = experiment.examples_folder() / module_of(EXAMPLE)
    example = {path.name: path.read_text(encoding="utf-8") for path in sorted(folder.iterdir()) if path.suffix in FILES}
    made = class_of(name)
    if any(re.search(rf"\b{made}\b", text) for text in example.values()) and name != EXAMPLE:
        raise ConfigError(f"{name}: its class would be {made}, a word that simulators use for something else; give another name")

    def renamed(text: str) -> str:
        for spelled in (str, module_of, class_of):
            text = text.replace(spelled(EXAMPLE), spelled(name))
        return text

    return {renamed(file): renamed(text) for file, text in example.items()}


def module_of(name: str) -> str:
    """The Python module of a simulator."""
    return name.replace("-", "_")


def class_of(name: str) -> str:
    """Its class."""
    return "".join(word.capitalize() for word in name.split("-"))


def _check(name: str) -> None:
    import importlib.util

    module = module_of(name)
    if not re.fullmatch(r"[a-z][a-z0-9]*(-[a-z0-9]+)*", name) or len(name) > 63:
        raise ConfigError(f"{name!r}: expected a name of small letters, digits and -, that begins with a letter: lost-robots")
    if name in plugins.names("simulator"):
        raise ConfigError(f"{name}: there is a simulator of that name (zswarm-ot list); give another name")
    if keyword.iskeyword(module) or importlib.util.find_spec(module) is not None:
        raise ConfigError(f"{name}: Python has a module {module} already; give another name, such as {name}-swarm")
