"""The examples in the docstrings of the packages for scientists run and give what they show."""

from __future__ import annotations

import doctest
import importlib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("daq", "identification", "dynamics", "analysis", "uncertainty", "rig_configs")
MODULES = [
    ".".join(path.relative_to(ROOT).with_suffix("").parts)
    for package in PACKAGES
    for path in sorted((ROOT / package).rglob("*.py"))
    if ">>> " in path.read_text("utf-8")
]


@pytest.mark.parametrize("package", PACKAGES)
def test_each_package_has_examples(package: str) -> None:
    assert [name for name in MODULES if name.startswith(f"{package}.")]


@pytest.mark.parametrize("name", MODULES)
def test_examples_run(name: str) -> None:
    """Each example begins without names: it imports what it uses, as a reader does."""
    module = importlib.import_module(name)
    found = doctest.DocTestFinder(exclude_empty=True).find(module, globs={})
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE)
    report: list[str] = []
    for example in found:
        runner.run(example, out=report.append)
    assert "".join(report) == ""
    assert runner.tries == Path(str(module.__file__)).read_text("utf-8").count(">>> ")
