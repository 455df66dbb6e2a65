"""Names to which docstrings refer, by "See …" and in "Raises:", are names of the project, of Python or of a library."""

from __future__ import annotations

import ast
import builtins
import importlib
import re
from collections.abc import Iterator
from itertools import takewhile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = sorted(path.parent for path in ROOT.glob("*/py.typed"))
MODULES = [path for package in PACKAGES for path in sorted(package.rglob("*.py"))]
# A name in code marks, a dotted one, or a word with a capital.
_SEE = re.compile(r"\b[Ss]ee (?:`+([\w.]+)`+|([a-z_]\w*(?:\.\w+)+|[A-Z]\w*[a-z]\w*))")
_RAISED = re.compile(r" {4}([\w.]+(?:, [\w.]+)*):")  # lines that continue an entry begin farther to the right


def names_in(tree: ast.Module) -> Iterator[str]:
    """Names that a module defines or imports."""
    for node in ast.walk(tree):
        match node:
            case ast.ClassDef(name=name) | ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name):
                yield name
            case ast.Import(names=names) | ast.ImportFrom(names=names):
                yield from (each.asname or each.name for each in names)
            case ast.Name(id=name, ctx=ast.Store()):
                yield name
            case _:
                pass


TREES = {path: ast.parse(path.read_text("utf-8")) for path in MODULES}
KNOWN = {
    *dir(builtins),
    *(name for tree in TREES.values() for name in names_in(tree)),
    *(part for path in MODULES for part in path.relative_to(ROOT).with_suffix("").parts),
}


def referred(text: str) -> Iterator[str]:
    """Names to which a docstring refers."""
    for found in _SEE.finditer(text):
        yield found[1] or found[2]
    _, _, after = text.partition("Raises:\n")
    for line in takewhile(lambda line: line.startswith("    "), after.splitlines()):
        if found := _RAISED.match(line):
            yield from found[1].split(", ")


def is_known(name: str) -> bool:
    """Whether a name exists; one with a dot in its module, which may be of a library."""
    place, _, last = name.rpartition(".")
    if not place or place.split(".")[0] in {package.name for package in PACKAGES}:
        return last in KNOWN
    try:
        return hasattr(importlib.import_module(place), last)
    except ImportError:
        return last in KNOWN  # `module.name`, with the module's last name only


@pytest.mark.parametrize("package", PACKAGES, ids=lambda path: path.name)
def test_docstrings_refer_to_what_exists(package: Path) -> None:
    unknown = [
        f"{path.relative_to(ROOT)}: {name}"
        for path, tree in TREES.items()
        if package in path.parents
        for node in ast.walk(tree)
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef)
        for name in referred(ast.get_docstring(node) or "")
        if not is_known(name)
    ]
    assert unknown == []


def test_references_are_found() -> None:
    text = (
        "See SpeedSource.\n\nTimes are old, see `daq.clock`; see queue.Queue.\n\nSee the page.\n\n"
        "Raises:\n    DeviceError, ValueError: it is wrong:\n        more of it: no name.\n    json.Wrong: other.\n"
        "\nReturns:\n    Nothing: none.\n"
    )
    assert list(referred(text)) == [
        "SpeedSource",
        "daq.clock",
        "queue.Queue",
        "DeviceError",
        "ValueError",
        "json.Wrong",
    ]
    assert [is_known(name) for name in ("DeviceError", "queue.Queue", "json.Wrong", "Refused")] == [
        True,
        True,
        False,
        False,
    ]
