"""Nothing above the transports distinguishes a simulated rig from a real one.

Read from the code: no module there, but the simulated far ends of devices and the rig in lockstep, imports the virtual
rig, reads a rig's [virtual] table or its truth, looks at what kind of link it holds, or names a kind of port. Seen in
behaviour: see test_session.py, where the same tests run over ptys and TCP, and replay decodes the bytes alone to the
same samples.
"""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ABOVE = sorted(
    path
    for package in ("daq", "rig_drivers", "identification", "analysis")
    for path in (ROOT / package).rglob("*.py")
    if not any(part in path.parts for part in ("transports", "virtual_rig", "lockstep", "far_end.py"))
)
BELOW_ONLY = {"virtual", "true_physics", "SerialLink", "SocketLink", "CanLink", "PtyWire", "TcpWire"}
PORT_KINDS = ("pty", "/dev/pts", "socket://", "loop://", "virtual", "simulated rig")


def strings_outside_docstrings(tree: ast.AST) -> list[str]:
    documented = set()
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            documented |= {
                id(s.value)
                for s in body
                if isinstance(s, ast.Expr) and isinstance(s.value, ast.Constant) and isinstance(s.value.value, str)
            }
    return [
        n.value
        for n in ast.walk(tree)
        if isinstance(n, ast.Constant) and isinstance(n.value, str) and id(n) not in documented
    ]


def differences(source: str) -> list[str]:
    """Return what in a module could distinguish the rigs."""
    tree = ast.parse(source)
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and node.attr in BELOW_ONLY:
            found.append(f"line {node.lineno}: .{node.attr}")
        if isinstance(node, ast.Name) and node.id in BELOW_ONLY:
            found.append(f"line {node.lineno}: {node.id}")
        if isinstance(node, ast.Import | ast.ImportFrom):
            names = [a.name for a in node.names] + [getattr(node, "module", None) or ""]
            found += [f"line {node.lineno}: imports {n}" for n in names if "virtual_rig" in n or n in BELOW_ONLY]
    found += [
        f"text {s!r}"
        for s in strings_outside_docstrings(tree)
        if any(re.search(rf"(?<![a-z]){k}", s.lower()) for k in PORT_KINDS)
    ]
    return found


@pytest.mark.parametrize("path", ABOVE, ids=lambda p: str(p.relative_to(ROOT)))
def test_module_does_not_distinguish(path: Path) -> None:
    assert differences(path.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize(
    "source",
    [
        "from daq.virtual_rig import run",
        "import daq.virtual_rig.run",
        "def f(rig):\n    return rig.virtual.truth",
        "def f(rig):\n    return rig.true_physics",
        "from daq.transports.link import SerialLink",
        "def f(link):\n    return link.name.startswith('/dev/pts')",
        "def f(link):\n    return isinstance(link, SocketLink)",
    ],
)
def test_the_check_sees_a_module_that_can(source: str) -> None:
    assert differences(source)
