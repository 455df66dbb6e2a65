"""Each tutorial runs through without a warning, uses public names only, and holds the outputs of its own code."""

from __future__ import annotations

import copy
import re
from pathlib import Path

import nbformat
import pytest
from nbclient.exceptions import CellExecutionError

from tests.tutorials.notebooks import (
    DIGEST,
    FOLDER,
    VARIES,
    code_cells,
    complaints_printed,
    executed,
    kinds,
    machine_paths,
    private_uses,
    read,
    sources_digest,
    tutorials,
)

LARGEST_BYTES = 500_000
each = pytest.mark.parametrize("path", tutorials(), ids=lambda path: path.stem)
TO_RENEW = "run `make tutorials`, look at the outputs, and commit them"


def test_there_is_one_for_each_reader() -> None:
    names = {path.stem for path in tutorials()}
    assert names == {"changed_spring", "first_campaign", "old_log", "own_sensor", "twenty_lines"}


@pytest.mark.lengthy
@each
def test_it_runs_without_a_warning_and_gives_what_is_stored(path: Path, tmp_path: Path) -> None:
    notebook = read(path)
    fresh = executed(notebook, tmp_path)
    assert complaints_printed(fresh) == []
    for number, (stored, now) in enumerate(zip(code_cells(notebook), code_cells(fresh), strict=True), 1):
        assert kinds(stored) == kinds(now), f"{path.name}, code cell {number}: stored outputs are stale: {TO_RENEW}"


@each
def test_what_is_stored_came_from_this_code_in_order(path: Path) -> None:
    notebook = read(path)
    cells = code_cells(notebook)
    assert notebook.metadata.get(DIGEST) == sources_digest(notebook), f"{path.name}: the code has changed: {TO_RENEW}"
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))
    assert complaints_printed(notebook) == []
    assert machine_paths(notebook) == []
    assert path.stat().st_size < LARGEST_BYTES


@each
def test_it_uses_public_names_only(path: Path) -> None:
    assert [use for cell in code_cells(read(path)) for use in private_uses(cell.source)] == []


@each
def test_it_reads_as_prose_with_figures(path: Path) -> None:
    cells = read(path).cells
    texts = [cell for cell in cells if cell.cell_type == "markdown"]
    assert cells[0].source.startswith("# ")
    assert "What to do next" in cells[-1].source
    assert sum(kinds(cell).count("figure") for cell in code_cells(read(path))) >= 2
    assert sum(len(text.source.split()) for text in texts) > 10 * len(cells)


@each
def test_readers_find_it(path: Path) -> None:
    assert f"]({path.name})" in (FOLDER / "index.md").read_text(encoding="utf-8")


@each
def test_what_it_links_to_is_there(path: Path) -> None:
    links = re.findall(r"\]\(([^)#:]+)\)", "\n".join(c.source for c in read(path).cells if c.cell_type == "markdown"))
    assert [link for link in links if not (FOLDER / link).exists()] == []


def test_twenty_lines_are_twenty_lines() -> None:
    code = "\n".join(cell.source for cell in code_cells(read(FOLDER / "twenty_lines.ipynb")))
    assert len([line for line in code.splitlines() if line.strip()]) <= 20


# --- the checks can fail -------------------------------------------------------------------------------------------


def notebook_of(*cells: str) -> nbformat.NotebookNode:
    return nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell) for cell in cells])


@pytest.mark.parametrize(
    ("code", "named"),
    [
        ("from daq.signals.run import load_run", "from daq.signals.run import load_run"),
        ("from daq import log", "from daq import log"),
        ("from identification.identify import identify", "from identification.identify import identify"),
        ("from benchmarks import worlds", "from benchmarks import worlds"),
        ("from rig_cli.demo import demo", "from rig_cli.demo import demo"),
        ("from live import server", "from live import server"),
        ("import daq", "import daq: import its names"),
        ("import analysis.figures.bode as bode", "import analysis.figures.bode: import its names"),
        ("import importlib", "import importlib"),
        ("rehearsal._session.close()", "._session"),
        ("__import__('daq.log')", "__import__"),
        ("from .notebooks import read", "from .notebooks import …"),
    ],
)
def test_a_private_name_is_named(code: str, named: str) -> None:
    assert private_uses(code) == [named]


def test_public_names_and_other_libraries_are_allowed() -> None:
    code = "%matplotlib inline\nimport numpy as np\nfrom daq import load_run\nfrom daq.exchange import make_recipe"
    assert private_uses(code) == []


@pytest.mark.parametrize(
    ("code", "why"),
    [
        ("import warnings\nwarnings.warn('old')", "UserWarning"),
        ("import socket\nsocket.create_connection(('127.0.0.1', 9))", "a tutorial needs no network"),
        ("1 / 0", "ZeroDivisionError"),
    ],
)
def test_a_warning_a_network_and_an_error_end_it(code: str, why: str, tmp_path: Path) -> None:
    with pytest.raises(CellExecutionError, match=why):
        executed(notebook_of("a = 1", code), tmp_path)


def test_other_outputs_and_complaints_are_seen(tmp_path: Path) -> None:
    fresh = executed(notebook_of("print('k1 is 2616.5 N/m')", "import sys\nprint('hm', file=sys.stderr)"), tmp_path)
    first, second = code_cells(fresh)
    other = copy.deepcopy(first)
    other.outputs[0].text = "k1 is 2.617e3 N/m\n"
    assert kinds(other) == kinds(first) == ["stdout: k# is # N/m"]
    other.outputs[0].text = "k1 is not known\n"
    assert kinds(other) != kinds(first)
    other.outputs = []
    assert kinds(other) != kinds(first)
    other = copy.deepcopy(first)
    other.outputs[0].text, other.metadata["tags"] = "k1 is not known\n", [VARIES]
    assert kinds(other) == ["stdout: …"]
    assert complaints_printed(fresh) == ["hm\n"]
    assert [first.execution_count, second.execution_count] == [1, 2]


@pytest.mark.parametrize("place", ["/home/ada/rig.toml", "written to /tmp/x1/a.mcap", r"C:\Users\ada\a.mcap"])
def test_a_place_on_a_machine_is_seen(place: str) -> None:
    notebook = notebook_of("path")
    code_cells(notebook)[0].outputs = [nbformat.v4.new_output("stream", text=place + "\n")]
    assert machine_paths(notebook) == [place]


def test_relative_names_units_and_addresses_are_no_place_on_a_machine() -> None:
    words = "out/tmp/a.mcap, 3 N/m, laser/x, https://mcap.dev/home/"
    notebook = notebook_of("path")
    code_cells(notebook)[0].outputs = [nbformat.v4.new_output("stream", text=words)]
    assert machine_paths(notebook) == []
