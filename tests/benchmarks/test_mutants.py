"""Places of a module at which mutants are drawn."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest

MODULE = '''
from functools import lru_cache
from typing import Protocol

from numba import njit


@njit(cache=True, nogil=True)
def compiled(x):
    """Text."""
    return 0


class Cached:
    @lru_cache(maxsize=8)
    def value(self):
        return 0

    @property
    def other(self):
        return 0


class Shape(Protocol):
    @property
    def b(self): ...
'''


def test_decorators_for_speed_and_protocols_are_not_mutated(tmp_path: Path) -> None:
    pytest.importorskip("cosmic_ray", reason="dependency group mutation")
    mutants = importlib.import_module("benchmarks.mutants")
    path = tmp_path / "module.py"
    path.write_text(MODULE, encoding="utf-8")
    lines = MODULE.splitlines()
    found = {(name, lines[line - 1].strip()) for name, _, line, _ in mutants.mutations(path)}
    assert {text for name, text in found if name == "RemoveDecorator"} == {"@property"}
    assert {text for _, text in found} == {"@property", "return 0"}
    assert sum(name == "RemoveDecorator" for name, *_ in mutants.mutations(path)) == 1
