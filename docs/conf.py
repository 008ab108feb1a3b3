"""Configure Sphinx for the site, `make docs`: offline, and every warning is an error.

The pages are plain Markdown and can be read as such: links to files that the site does not have
lead there all the same.
"""

import re
from pathlib import Path

from pygments.lexers.special import TextLexer
from sphinx.application import Sphinx

import zswarm

project = "zswarm"
author = "The zswarm developers"
copyright = "The zswarm developers, Apache-2.0"  # noqa: A001  the name that Sphinx reads
release = version = zswarm.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
]
exclude_patterns = ["pictures"]
nitpicky = True
smartquotes = False  # "fixed" is what is typed
nitpick_ignore_regex = [
    # Types of libraries, which are not looked up in the network, and shapes in words.
    ("py:.*", r"(?!zswarm\.).*"),
    ("py:class", r"zswarm\..*\.T"),  # type variables
    # Documented elsewhere, or not for users.
    (
        "py:.*",
        r"zswarm\.(config|experiment|ot\.(run|record|workload|discovery|embedding))\..*",
    ),
]

myst_enable_extensions = ["amsmath", "colon_fence", "dollarmath"]
myst_heading_anchors = 3  # as on a forge: commands.md#run

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
napoleon_numpy_docstring = False

html_theme = "furo"
html_title = "zswarm"
html_static_path = ["static"]
html_css_files = ["zswarm.css"]
html_show_sourcelink = False
html_copy_source = False
html_theme_options = {"footer_icons": []}
copybutton_prompt_text = "$ "
copybutton_only_copy_prompt_lines = True
copybutton_remove_prompts = True

# Files of the repository that are pages of the site, too.
FROM_THE_REPOSITORY = {
    "CHANGELOG": "changelog",
    "CONTRIBUTING": "contributing",
    "SECURITY": "reporting",
}
REPOSITORY = Path(__file__).parent.parent
# A link that has the name of its file for a text: on the site it has the title of the page or
# heading.
BY_FILE = re.compile(
    r"\[(?:docs/)?(?P<page>[\w-]+)\.md\]\((?P<target>(?P=page)\.md(?:#[\w-]+)?)\)"
)


def within_the_site(app: Sphinx, page: str, source: list[str]) -> None:  # noqa: ARG001  Sphinx calls it so
    """Redirect links to files that became pages; give links named after a file the page's title."""
    name = next(
        (name for name, made in FROM_THE_REPOSITORY.items() if made == page), None
    )
    if name:
        source[0] = (
            (REPOSITORY / f"{name}.md")
            .read_text(encoding="utf-8")
            .replace("](docs/", "](")
        )
        for file in (
            ".ci/",
            "examples/",
            "benchmarks/",
            "tests/",
            "deploy/",
            "zswarm/",
            "README.md",
            "LICENSE",
            "CITATION.cff",
        ):
            source[0] = source[0].replace(f"]({file}", f"](../{file}")
    for file, made in FROM_THE_REPOSITORY.items():
        source[0] = source[0].replace(f"](../{file}.md", f"]({made}.md")
        if name:
            source[0] = source[0].replace(f"]({file}.md", f"]({made}.md")
    source[0] = BY_FILE.sub(r"[](\g<target>)", source[0])


def setup(app: Sphinx) -> None:
    """Connect to Sphinx's events."""
    app.add_lexer("hex", TextLexer)
    app.connect("source-read", within_the_site)
