"""Nothing above a driver names a maker or a device of a rig: identifiers and texts of these rooms are read for them.

Makers are the names of the registered drivers; devices those of the shipped rig files. A word of the field that a rig
file uses as a device's name may stand in a sentence or an identifier, but never alone as a text: there it is a key.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from rig_configs import load_rig
from rig_configs.drivers import installed

ROOT = Path(__file__).parents[1]
ROOMS = (
    "identification",
    "analysis",
    "daq/signals",
    "daq/exchange",
    "daq/replay",
    "daq/log",
    "daq/acquisition",
    "daq/guided_tests",
)
SHIPPED = sorted(path.stem for path in (ROOT / "rig_configs").glob("*.toml"))
MAKERS = sorted(installed())
DEVICES = sorted({name for rig in SHIPPED for name in load_rig(rig).devices})

FIELD_WORDS = {
    "encoder": "the thing on a pendulum's pivot",
    "rotor": "what the rig turns",
    "drive": "what turns it",
    "motor": "the machine in it",
    "probe": "a displacement sensor, and to try something",
}
ALONE = {
    "encoder": "the kind of an event, a pendulum's encoder is faulty",
    "motor": "the channel of the speed",
    "rotor": "what acts in a state of a guided test: a drive or a hand",
}
"""Field words that also stand alone as a text, with what they mean there."""

_FIELDS = (
    "name",
    "id",
    "arg",
    "attr",
    "module",
    "asname",
    "rest",
    "names",
)


def identifiers(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Every name in a module, with its line."""
    line = 0
    for node in ast.walk(tree):
        line = getattr(node, "lineno", line)
        for field in _FIELDS:
            value = getattr(node, field, None)
            for text in value if isinstance(value, list) else [value]:
                if isinstance(text, str):
                    yield line, text


def texts(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Every text in a module, docstrings too, with its line; NUL where a formatted text takes a value."""
    inside: set[int] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            inside |= {id(part) for part in node.values}
            yield node.lineno, "".join(str(p.value) if isinstance(p, ast.Constant) else "\0" for p in node.values)
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in inside:
            yield node.lineno, node.value


def named(source: str) -> list[str]:
    """What in a module is a maker's or a device's name."""
    tree = ast.parse(source)
    found: list[str] = []
    for line, text in [*identifiers(tree), *texts(tree)]:
        found += [f"line {line}: maker {maker}: {text[:60]!r}" for maker in MAKERS if maker in text.lower()]
    for line, text in identifiers(tree):
        found += [f"line {line}: device {text}" for name in DEVICES if name not in FIELD_WORDS and _holds(text, name)]
    for line, text in texts(tree):
        found += [f"line {line}: device {name}: {text[:60]!r}" for name in DEVICES if _is_device(text, name)]
    return found


def _holds(text: str, name: str) -> bool:
    return re.search(rf"(?<![A-Za-z0-9]){name}(?![A-Za-z0-9])", text) is not None


def _is_device(text: str, name: str) -> bool:
    if name in FIELD_WORDS:
        return (text == name and name not in ALONE) or re.fullmatch(rf"(clock|gain) {name}", text) is not None
    stem = name.rpartition("_")[0]
    made = stem and re.search(rf"(?<![A-Za-z0-9]){stem}_(\0|$)", text)  # f"laser_{axis}"
    return _holds(text, name) or bool(made)


MODULES = sorted(path for room in ROOMS for path in (ROOT / room).rglob("*.py"))


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(ROOT)))
def test_a_module_names_no_maker_and_no_device(path: Path) -> None:
    assert named(path.read_text(encoding="utf-8")) == []


def test_the_names_are_those_of_drivers_and_rig_files() -> None:
    assert {"optoncdt", "cia402", "rotorlink"} <= set(MAKERS)
    assert {"laser_x", "encoder", "drive", "east"} <= set(DEVICES)
    assert set(FIELD_WORDS) <= set(DEVICES)
    assert set(ALONE) <= set(FIELD_WORDS)
    assert len(MODULES) > 150


@pytest.mark.parametrize(
    "source",
    [
        "from daq.drivers.optoncdt import wire",
        "import daq.drivers.cia402.control as c",
        "class RotorlinkNode: pass",
        "def f():\n    '''Reads an optoNCDT sensor.'''",
        "rig.devices['laser_x']",
        "rig.devices['drive']",
        "label = 'clock encoder'",
        "label = f'gain laser_{axis}'",
        "text = f'no sample of laser_y in {path}'",
        "laser_x = 1",
        "def f(east): pass",
        "def f(a):\n    return a.laser_y_time",
        "f(laser_x=3)",
    ],
)
def test_the_check_sees_a_name(source: str) -> None:
    assert named(source)


@pytest.mark.parametrize(
    "source",
    ["'the rotor stands: its encoder is sound'", "laser_noise_m = 'laser/x'", "f'clock {device}'", "rotor.drive()"],
)
def test_the_check_lets_the_field_s_words_pass(source: str) -> None:
    assert named(source) == []
