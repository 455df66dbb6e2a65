"""Drawings of the architecture, made from the code: the way of the data, and the packages in their layers.

Names, first sentences and imports are read from the sources, the layers from pyproject.toml. A name that no longer
exists, or a step between modules that do not know each other, stops the build.
"""

from __future__ import annotations

import ast
import re
import textwrap
import tomllib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache
from html import escape
from pathlib import Path

ROOT = Path(__file__).parents[2]
_WIDTH, _HEIGHT, _GAP_X, _GAP_Y = 190, 76, 62, 54  # of a box and between boxes, px
_LINE = 15  # px between lines of text
_HEAD = 'markerWidth="8" markerHeight="8" refX="7" refY="4" orient="auto"'


@dataclass(frozen=True)
class Step:
    """A box: what happens to the data, the name in the code that does it, and its place in the drawing."""

    title: str
    name: str
    column: int
    row: int


# The far end stands for the devices: bytes of hardware enter by the same links.
STEPS = (
    Step("devices, or virtual rig", "daq.virtual_rig.rig:SimulatedRig", 0, 0),
    Step("bytes", "daq.transports.link:Link", 1, 0),
    Step("samples", "daq.drivers.contract:Pipeline", 2, 0),
    Step("decisions", "daq.acquisition.core:Core", 3, 0),
    Step("log", "daq.acquisition.recorder:Recorder", 4, 0),
    Step("stop, speed, locks", "daq.acquisition.rotor_command:RotorCommand", 1, 1),
    Step("session", "daq.acquisition.session:Session", 2, 1),
    Step("interlocks", "daq.acquisition.interlocks:Interlocks", 3, 1),
    Step("live page", "live.session_page:LivePage", 2, 2),
    Step("log read", "daq.log.opened:open_log", 4, 2),
    Step("decoded again", "daq.replay.decoded_again:decode_again", 4, 3),
    Step("signals", "daq.signals.run:load_run", 3, 3),
    Step("parameters", "identification.identify:identify", 2, 3),
    Step("verdicts", "analysis.validation:validate", 1, 3),
    Step("report", "analysis.report.write:write_report", 0, 3),
)
# From, to, what is handed over. Some module imports both ends, except where a port or a file lies between them.
FLOWS = (
    ("devices, or virtual rig", "bytes", "port"),
    ("bytes", "samples", "raw"),
    ("samples", "decisions", "items"),
    ("decisions", "log", "raw, items"),
    ("decisions", "interlocks", ""),
    ("decisions", "session", "orders"),
    ("session", "stop, speed, locks", ""),
    ("stop, speed, locks", "bytes", "commands"),
    ("session", "live page", ""),
    ("log", "log read", ".mcap"),
    ("log read", "decoded again", "raw"),
    ("log read", "signals", "items"),
    ("signals", "parameters", ""),
    ("parameters", "live page", ".toml"),
    ("parameters", "verdicts", ".toml"),
    ("verdicts", "report", ""),
)
_FILES = {"port", ".mcap", ".toml"}


@cache
def _tree(module: str) -> ast.Module:
    base = ROOT.joinpath(*module.split("."))
    file = base / "__init__.py" if base.is_dir() else base.with_suffix(".py")
    return ast.parse(file.read_text(encoding="utf-8"))


def sentence_of(name: str) -> str:
    """Return the first sentence of the docstring of "module:name", or of a module.

    Raises:
        LookupError: the name or its docstring does not exist.
    """
    module, _, wanted = name.partition(":")
    documented = (ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    tree = _tree(module)
    nodes = [one for one in tree.body if isinstance(one, documented) and one.name == wanted] if wanted else [tree]
    text = ast.get_docstring(nodes[0]) if nodes else None
    if not text:
        raise LookupError(f"drawings: {name} has no docstring, or does not exist: correct the drawing's table")
    return re.split(r"[.:;] ", " ".join(text.split()))[0].rstrip(".").replace("`", "")


@cache
def _imports() -> dict[str, set[str]]:
    """Return the modules and packages of the project that each module names in its imports, and itself."""
    found: dict[str, set[str]] = {}
    for package in packages():
        for file in (ROOT / package).rglob("*.py"):
            module = ".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
            named = {module}
            for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
                if isinstance(node, ast.ImportFrom) and node.module and not node.level:
                    named |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
                elif isinstance(node, ast.Import):
                    named |= {alias.name for alias in node.names}
            found[module] = named
    return found


def unknown_flows() -> list[str]:
    """List the flows of which no module of the project imports both ends."""
    name_of = {step.title: step.name for step in STEPS}
    return [
        f"{start} → {end}: no module imports {name_of[start]} and {name_of[end]}"
        for start, end, what in FLOWS
        if what not in _FILES
        and not any(known & _paths(name_of[start]) and known & _paths(name_of[end]) for known in _imports().values())
    ]


def _paths(name: str) -> set[str]:
    """Return the module, and the name in each package above it that may pass it on."""
    module, _, own = name.partition(":")
    parts = module.split(".")
    return {module, *(f"{'.'.join(parts[:k])}.{own}" for k in range(1, len(parts) + 1))}


def layers() -> list[list[str]]:
    """Return the packages by layer, the uppermost first, as the check of the imports reads them."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    first = settings["tool"]["importlinter"]["contracts"][0]
    return [[name.strip() for name in layer.split("|")] for layer in first["layers"]]


def packages() -> list[str]:
    """Return all packages, those of the uppermost layer first."""
    return [name for layer in layers() for name in layer]


def direct_imports() -> set[tuple[str, str]]:
    """Return pairs (importing package, imported package), without those that follow from the others."""
    known = set(packages())
    pairs = {
        (module.partition(".")[0], name.partition(".")[0]) for module, names in _imports().items() for name in names
    }
    pairs = {(a, b) for a, b in pairs if a != b and b in known}
    reached = {a: _reached(a, pairs) for a in known}
    return {(a, b) for a, b in pairs if not any(b in reached[c] for x, c in pairs if x == a and c != b)}


def _reached(start: str, pairs: set[tuple[str, str]]) -> set[str]:
    found: set[str] = set()
    waiting = [start]
    while waiting:
        here = waiting.pop()
        new = {b for a, b in pairs if a == here} - found
        found |= new
        waiting += new
    return found


def way_of_data() -> str:
    """Return the way of the data as SVG.

    Raises:
        LookupError: a step or a flow is not in the code.
    """
    if faults := unknown_flows():
        raise LookupError("drawings: " + "; ".join(faults))
    boxes = {step.title: (step.column, step.row) for step in STEPS}
    drawn = [_arrow(boxes[start], boxes[end], what) for start, end, what in FLOWS]
    drawn += [_box(boxes[one.title], one.title, one.name.partition(":")[2], sentence_of(one.name)) for one in STEPS]
    return _svg("The way of the data", drawn, 1 + max(s.column for s in STEPS), 1 + max(s.row for s in STEPS))


def packages_drawn() -> str:
    """Return the packages in their layers as SVG, with the imports that do not follow from others."""
    rows = layers()
    widest = max(len(row) for row in rows)
    places = {name: ((widest - len(row)) / 2 + k, r) for r, row in enumerate(rows) for k, name in enumerate(row)}
    drawn = [_arrow(places[a], places[b], "") for a, b in sorted(direct_imports())]
    drawn += [_box(place, name, _modules(name), sentence_of(name)) for name, place in places.items()]
    return _svg("The packages in their layers", drawn, widest, len(rows))


def _modules(package: str) -> str:
    return f"{sum(name.partition('.')[0] == package for name in _imports())} modules"


def _corner(column: float, row: float) -> tuple[float, float]:
    return 8 + column * (_WIDTH + _GAP_X), 8 + row * (_HEIGHT + _GAP_Y)


def _box(place: tuple[float, float], title: str, name: str, sentence: str) -> str:
    x, y = _corner(*place)
    lines = textwrap.wrap(sentence, 30, max_lines=2, placeholder=" …")
    text = [f'<tspan x="{x + 10}" y="{y + 18}" class="title">{escape(title)}</tspan>']
    text.append(f'<tspan x="{x + 10}" y="{y + 18 + _LINE}" class="name">{escape(name)}</tspan>')
    text += [
        f'<tspan x="{x + 10}" y="{y + 18 + (2 + k) * _LINE}">{escape(line)}</tspan>' for k, line in enumerate(lines)
    ]
    tip = f"<title>{escape(sentence)}.</title>"
    return f'<g>{tip}<rect x="{x}" y="{y}" width="{_WIDTH}" height="{_HEIGHT}" rx="5"/><text>{"".join(text)}</text></g>'


def _arrow(start: tuple[float, float], end: tuple[float, float], what: str) -> str:
    """Return an arrow from edge to edge: sideways within a row, else from one row to another."""
    (x0, y0), (x1, y1) = _corner(*start), _corner(*end)
    if start[1] == end[1]:
        right = end[0] > start[0]
        points = (x0 + _WIDTH * right, y0 + _HEIGHT / 2, x1 + _WIDTH * (not right), y1 + _HEIGHT / 2)
    else:
        down = end[1] > start[1]
        points = (x0 + _WIDTH / 2, y0 + _HEIGHT * down, x1 + _WIDTH / 2, y1 + _HEIGHT * (not down))
    path = "M{:.0f} {:.0f}L{:.0f} {:.0f}".format(*points)
    x, y = (points[0] + points[2]) / 2, (points[1] + points[3]) / 2
    sideways = points[1] == points[3]
    place = f'x="{x:.0f}" y="{y - 6:.0f}" text-anchor="middle"' if sideways else f'x="{x + 6:.0f}" y="{y + 4:.0f}"'
    label = f'<text class="flow" {place}>{escape(what)}</text>' if what else ""
    return f'<path d="{path}" marker-end="url(#head)"/>{label}'


def _svg(title: str, drawn: Iterable[str], columns: int, rows: int) -> str:
    width, height = columns * (_WIDTH + _GAP_X) - _GAP_X + 16, rows * (_HEIGHT + _GAP_Y) - _GAP_Y + 16
    return (
        f'<svg class="drawing" style="max-width: {width}px" viewBox="0 0 {width} {height}" role="img" '
        f'aria-label="{escape(title)}">'
        f'<defs><marker id="head" {_HEAD}><path class="head" d="M0 0L8 4L0 8z"/></marker></defs>'
        f"{''.join(drawn)}</svg>"
    )


# Comment on a page that is replaced by the drawing.
MARKS: dict[str, Callable[[], str]] = {
    "% The way of the data is drawn here.": way_of_data,
    "% The packages are drawn here.": packages_drawn,
}


def with_drawings(page: str) -> str:
    """Return the text of a page with each mark replaced by its drawing."""
    for mark, draw in MARKS.items():
        if mark in page:
            page = page.replace(mark, f"```{{raw}} html\n{draw()}\n```")
    return page
