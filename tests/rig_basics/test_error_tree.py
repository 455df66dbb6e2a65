"""Every error class of the packages is below RigError, or is used inside one module only."""

from __future__ import annotations

import ast
import importlib
import inspect
from pathlib import Path

import pytest

import rig_basics.errors
from rig_basics.errors import RigError

ROOT = Path(__file__).parents[2]
PACKAGES = (
    "dynamics",
    "uncertainty",
    "rig_configs",
    "daq",
    "identification",
    "analysis",
    "studies",
    "live",
    "reproduction",
)
OUTSIDE = {  # classes that no caller of the packages handles, with the reason
    "daq/log/source.py: IndexWrongError": "ends the use of an index; the file is then read without it",
    "daq/mcap/records.py: DamageError": "ends one record; the reader turns it into a listed damage",
    "daq/drivers/rotorlink/wire.py: BadFrame": "ends one frame; the decoder counts it",
    "daq/lockstep/clock.py: WaitNeverEnds": "a defect of the test or of the driver under test",
    "rig_testing/report.py: Failed": "a failed test, as pytest expects it",
    "rig_testing/report.py: NotTried": "a skipped test",
}


def _error_classes() -> dict[str, tuple[str, str]]:
    """Return the public exception classes of the tree: "file: class" → module, class."""
    found: dict[str, tuple[str, str]] = {}
    for package in (*PACKAGES, "rig_testing", "rig_cli"):
        for path in sorted((ROOT / package).rglob("*.py")):
            source = path.read_text("utf-8")
            if "Error" not in source and "Exception" not in source:
                continue
            module = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
            for node in ast.parse(source).body:
                if not isinstance(node, ast.ClassDef) or node.name.startswith("_") or not node.bases:
                    continue
                kind = getattr(importlib.import_module(module), node.name)
                if inspect.isclass(kind) and issubclass(kind, Exception):
                    found[f"{path.relative_to(ROOT).as_posix()}: {node.name}"] = (module, node.name)
    return found


def test_public_errors_have_one_root() -> None:
    classes = _error_classes()
    assert len(classes) > 40, "the search finds the classes"
    outside = {
        where
        for where, (module, name) in classes.items()
        if not issubclass(getattr(importlib.import_module(module), name), RigError)
    }
    assert outside == set(OUTSIDE)


@pytest.mark.parametrize("package", PACKAGES)
def test_a_drawn_tree_lists_its_classes(package: str) -> None:
    module = importlib.import_module(f"{package}.errors")
    drawn = {line.split()[0].lstrip("│├└─ ") for line in _tree(module.__doc__ or "")}
    defined = {
        name
        for name, kind in vars(module).items()
        if inspect.isclass(kind) and issubclass(kind, RigError) and kind.__module__ == module.__name__
    }
    assert drawn == defined


def test_the_root_names_every_root_of_a_package() -> None:
    drawn = {line.split()[0]: line.split()[1] for line in _tree(rig_basics.errors.__doc__ or "")[1:]}
    roots = {
        kind.__name__: package
        for package in PACKAGES
        for kind in vars(importlib.import_module(f"{package}.errors")).values()
        if inspect.isclass(kind) and kind.__bases__[0] is RigError
    }
    assert drawn == roots


def _tree(text: str) -> list[str]:
    """Return the lines of the drawn tree without its branches."""
    lines = [line.strip() for line in text.splitlines()]
    first = next(number for number, line in enumerate(lines) if line.split() and line.split()[0].endswith("Error"))
    tree = [lines[first], *[line for line in lines[first + 1 :] if line.startswith(("│", "├", "└"))]]
    return [line.lstrip("│├└─ ") for line in tree]
