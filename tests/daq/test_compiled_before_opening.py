"""Nothing that an acquisition runs is compiled after the devices were opened."""

from __future__ import annotations

import subprocess
import sys

_LISTS_UNCOMPILED = """
import ast, importlib, inspect, pkgutil
from numba.core.dispatcher import Dispatcher
from daq.acquisition.compiled import compile_acquisition

compile_acquisition()
names = ["daq.clock"]
for room in ("daq.acquisition", "daq.guided_tests", "daq.signals"):
    names += [found.name for found in pkgutil.walk_packages(importlib.import_module(room).__path__, room + ".")]
modules = [importlib.import_module(name) for name in names]
called = set()  # names that functions of the interpreter use: the others are compiled with their callers
for module in modules:
    for node in ast.walk(ast.parse(inspect.getsource(module))):
        if isinstance(node, ast.FunctionDef) and "jit" not in "".join(map(ast.unparse, node.decorator_list)):
            called |= {each.id for each in ast.walk(node) if isinstance(each, ast.Name)}
for module in modules:
    for name, value in vars(module).items():
        if isinstance(value, Dispatcher) and name in called and not value.signatures:
            print(module.__name__, name)
"""


def test_every_compiled_loop_of_an_acquisition_is_ready_before_a_device_is_opened() -> None:
    found = subprocess.run(
        [sys.executable, "-c", _LISTS_UNCOMPILED], capture_output=True, text=True, check=True, timeout=300
    )
    assert found.stdout == ""
