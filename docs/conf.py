"""Sphinx settings of the documentation. `make docs` builds it with warnings as errors, from the installed wheel."""

from __future__ import annotations

import importlib.metadata
import re
import sys
from pathlib import Path
from typing import Any

from sphinx.util import logging

sys.path.insert(0, str(Path(__file__).parent / "_ext"))

from built_pages import far_pages, faults_of_site, mathjax
from drawings import with_drawings

DISTRIBUTION = "pendulum-balancer-rig"

project = "Pendulum-balancer rig"
author = "The pendulum-balancer rig's founders"
release = importlib.metadata.version(DISTRIBUTION)
version = release

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.mathjax",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinx_copybutton",
    "sphinx_design",
]
exclude_patterns = ["_build"]

# Notebooks are executed by the test suite and kept with their outputs.
nb_execution_mode = "off"
nb_output_stderr = "show"
myst_enable_extensions = ["amsmath", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3
# They turn the two hyphens of an option into a dash, the primes of a derivative and a shell's quotes into curly ones.
smartquotes = False

# The script is copied from a wheel, so that equations are set without a network.
mathjax_path = mathjax().name

html_theme = "furo"
html_title = f"{project} {release}"
html_static_path = [str(mathjax()), "_ext/drawings.css"]
html_css_files = ["drawings.css"]

autodoc_member_order = "groupwise"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_custom_sections = [("Source", "notes_style")]
python_use_unqualified_type_names = True

# Comment in docs/commands.md that is replaced by the commands in their groups.
OVERVIEW_MARK = "% The commands of `rig --help` are inserted here."

_CODE = re.compile(r"(``?)(.+?)\1")


def _escaped(line: str) -> str:
    """Escape reStructuredText markup in one docstring line; text in single backticks becomes a literal.

    The docstrings are plain text: |z|, trailing underscores and asterisks have no markup meaning in them.
    """
    parts: list[str] = []
    end = 0
    for code in _CODE.finditer(line):
        parts.append(_plain(line[end : code.start()]))
        parts.append(f"``{code.group(2)}``")
        end = code.end()
    return "".join([*parts, _plain(line[end:])])


def _plain(text: str) -> str:
    return re.sub(r"([|*`]|_(?=\W|$))", r"\\\1", text)


def _process_docstring(app: Any, what: str, name: str, value: Any, options: Any, lines: list[str]) -> None:
    """Convert plain-text docstrings to reStructuredText before napoleon reads their sections."""
    inside_example = False
    for number, line in enumerate(lines):
        inside_example = line.lstrip().startswith(">>>") or (inside_example and bool(line.strip()))
        if not inside_example:
            lines[number] = _escaped(line)


def _add_command_reference(app: Any, docname: str, source: list[str]) -> None:
    """Add the commands in their groups, and the options of every command, to the page "commands"."""
    if docname != "commands":
        return
    from command_reference import overview, reference  # imports every command

    source[0] = source[0].replace(OVERVIEW_MARK, overview()) + reference()


def _add_setting_tables(app: Any, docname: str, source: list[str]) -> None:
    """Add the settings of every driver, and the table of physical numbers, to their pages of the reference."""
    if docname not in ("reference/drivers", "reference/rig_configs"):
        return
    from setting_tables import MARK, NUMBERS_MARK, all_tables, physical_table  # imports every driver's settings

    made = (MARK, all_tables) if docname == "reference/drivers" else (NUMBERS_MARK, physical_table)
    source[0] = source[0].replace(made[0], made[1]())


def _draw(app: Any, docname: str, source: list[str]) -> None:
    source[0] = with_drawings(source[0])


def _require_wheel(app: Any) -> None:
    """Raise an error if the packages are imported from the working tree instead of the installed wheel."""
    import daq  # imported only while the documentation is built

    if "site-packages" not in Path(daq.__file__).parts:
        raise RuntimeError(
            f"expected the installed wheel, imported {daq.__file__}: build the documentation with make docs"
        )


def _check_pages(app: Any, exception: Exception | None) -> None:
    """Warn of each page that needs the network, shows an option without its hyphens, or is far from the first page."""
    if exception is None and app.builder.name == "html":
        far = [f"{page}: more than two clicks from the first page" for page in far_pages(app.env.toctree_includes)]
        for fault in [*faults_of_site(Path(app.outdir)), *far]:
            logging.getLogger("built_pages").warning(fault)


def setup(app: Any) -> None:
    """Register the docstring conversion ahead of napoleon (priority 500)."""
    app.connect("builder-inited", _require_wheel)
    app.connect("source-read", _add_command_reference)
    app.connect("source-read", _add_setting_tables)
    app.connect("source-read", _draw)
    app.connect("build-finished", _check_pages)
    app.connect("autodoc-process-docstring", _process_docstring, priority=400)
