"""Source files that compiled functions are made of: the modules that define them, and all project modules these import.

A compiled function contains the code of the functions that it calls and the values, at the time of compilation, of the
names that it reads: `from dynamics.equations.kernels import FA` freezes a number of another file. A module without a
compiled function belongs to the set if a module of the set imports it at its top level. An import inside a function
freezes nothing.

The files are found by their text, which takes a tenth of the time that a syntax tree takes. Tests compare the result
with the syntax trees. A docstring that contains an import statement at the beginning of a line can only add a file.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path

PACKAGES: tuple[str, ...] = (
    "analysis",
    "daq",
    "dynamics",
    "identification",
    "rig_basics",
    "rig_configs",
    "uncertainty",
)
"""Packages that may contain compiled functions. No file of another package is read. Tests search all packages."""

_MARKS = (b"@njit", b"@compiled")  # decorators of compiled functions
_IMPORT = re.compile(rb"\n(?:from ([\w.]+) import (\([^)]*\)|.*)|import (.*))")
_COMMENT = re.compile(rb"#.*")
_NAME = re.compile(rb"(\w+)(?:\s+as\s+\w+)?")


def compiled_sources(root: Path) -> dict[str, bytes]:
    """Return the contents of all files that compiled functions are made of.

    Args:
        root: directory that contains the packages, or some of them.
    Returns:
        Contents by path relative to `root`, with `/`, in alphabetical order.
    """
    present = [(os.path.join(root, package), package) for package in PACKAGES if (root / package).is_dir()]
    texts = {name: _read(path) for place in present for name, path in _files(*place)}
    found = set[str]()
    waiting = [name for name, text in texts.items() if any(mark in text for mark in _MARKS)]
    while waiting:
        name = waiting.pop()
        if name not in found:
            found.add(name)
            waiting += _imported(texts[name], texts)
    return {name: texts[name] for name in sorted(found)}


def _files(directory: str, name: str) -> Iterator[tuple[str, str]]:
    with os.scandir(directory) as entries:
        for entry in entries:
            if entry.name.endswith((".py", ".pyi")):
                yield f"{name}/{entry.name}", entry.path
            elif "." not in entry.name and entry.name != "__pycache__" and entry.is_dir():
                yield from _files(entry.path, f"{name}/{entry.name}")


def _read(path: str) -> bytes:
    with open(path, "rb", buffering=0) as file:
        return file.read()


def _imported(text: bytes, known: dict[str, bytes]) -> Iterator[str]:
    """Yield the files of `known` from which a module imports at its top level."""
    for package, names, modules in _IMPORT.findall(b"\n" + text):
        if not package:
            places = [module.strip().split(b" ")[0] for module in modules.split(b",")]
        elif package.split(b".")[0].decode() in PACKAGES:
            places = [place for name in _names(names) for place in _places(package, name, known)]
        else:
            continue
        yield from filter(None, (_file(place, known) for place in places))


def _places(package: bytes, name: bytes, known: dict[str, bytes]) -> list[bytes]:
    """Return the modules that `from package import name` reads.

    A submodule is read itself. Another name of a package comes from its `__init__.py`, or, if the package imports at
    first use, from the module that its `__init__.pyi` names.
    """
    if _file(package + b"." + name, known):
        return [package + b"." + name]
    stub = known.get(f"{package.decode().replace('.', '/')}/__init__.pyi", b"")
    return [package, *(package + at for at, names, _ in _IMPORT.findall(stub) if name in _names(names))]


def _names(listed: bytes) -> list[bytes]:
    return _NAME.findall(_COMMENT.sub(b"", listed) if b"#" in listed else listed)


def _file(module: bytes, known: dict[str, bytes]) -> str | None:
    stem = module.decode().replace(".", "/")
    return next((name for name in (f"{stem}.py", f"{stem}/__init__.py") if name in known), None)
