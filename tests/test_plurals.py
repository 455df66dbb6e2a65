"""Counted nouns agree with their number: "1 sample lost", never "1 samples lost".

`rig_basics.texts.number_of` makes all of them, and `daq.items.loss_words` those of losses, whose noun is a key. Numbers
that are constants of a module, and numbers with decimals, have a fixed noun.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from daq.items import loss_words
from rig_basics.texts import number_of

ROOT = Path(__file__).parents[1]
PACKAGES = sorted(path.parent.name for path in ROOT.glob("*/py.typed"))
COUNTED = [
    "averages",
    "batches",
    "bits",
    "blocks",
    "bytes",
    "campaigns",
    "cases",
    "channels",
    "characters",
    "checks",
    "chunks",
    "claims",
    "columns",
    "commands",
    "comparisons",
    "counts",
    "cycles",
    "devices",
    "digits",
    "directions",
    "draws",
    "encoders",
    "errors",
    "estimates",
    "events",
    "figures",
    "files",
    "frames",
    "inputs",
    "items",
    "iterations",
    "lasers",
    "lines",
    "logs",
    "marks",
    "messages",
    "modes",
    "numbers",
    "objects",
    "orders",
    "outliers",
    "packets",
    "pairs",
    "parameters",
    "places",
    "points",
    "polls",
    "poles",
    "ports",
    "processes",
    "quantities",
    "readings",
    "records",
    "recordings",
    "registers",
    "releases",
    "reports",
    "requests",
    "results",
    "revolutions",
    "rigs",
    "rows",
    "runs",
    "samples",
    "scans",
    "seconds",
    "sensors",
    "sets",
    "start-ups",
    "states",
    "steps",
    "summaries",
    "tests",
    "times",
    "trials",
    "turns",
    "unknowns",
    "values",
    "viewers",
    "warnings",
    "windows",
    "words",
    "workers",
]
NOUN = re.compile(rf" ((?:[\w-]+ ){{0,2}}?)({'|'.join(COUNTED)})(?![\w/-])")
# A word after which the noun is not what the number in front of it counts.
OTHER_SENTENCE = {
    "and",
    "both",
    "brings",
    "for",
    "has",
    "have",
    "in",
    "it",
    "of",
    "own",
    "that",
    "the",
    "these",
    "with",
}
DECIMALS = re.compile(r"[efg%]$|^0")
# Texts, not numbers: a verb follows, or a range such as "1.7 to 65".
TEXTS = {("role.role", "names"), ("clock.topic", "steps"), ("times", "times"), ("errors", "times")}


def fixed_nouns(source: str) -> list[str]:
    """Return the counted nouns of a module that do not depend on their number."""
    tree = ast.parse(source)
    of_one = {id(part) for node in ast.walk(tree) if _compares_with_one(node) for part in ast.walk(node)}
    texts = [node for node in ast.walk(tree) if isinstance(node, ast.JoinedStr)]
    found = [f"{node.lineno}: {words}" for node in texts if id(node) not in of_one for words in _fixed(node)]
    expressions = [node for node in ast.walk(tree) if isinstance(node, ast.expr)]
    return found + [f"{node.lineno}: {ast.unparse(node)}" for node in expressions if _appends_an_s(node)]


def _fixed(text: ast.JoinedStr) -> Iterator[str]:
    for i, part in enumerate(text.values[:-1]):
        after = text.values[i + 1]
        if not isinstance(part, ast.FormattedValue) or not isinstance(after, ast.Constant):
            continue
        what, form = ast.unparse(part.value), "" if part.format_spec is None else ast.unparse(part.format_spec)[2:-1]
        if DECIMALS.search(form) or _is_constant(part.value) or "number_of(" in what or ".join(" in what:
            continue
        noun = NOUN.match(str(after.value))
        if noun and (what, noun[2]) not in TEXTS and not OTHER_SENTENCE & set(noun[1].split()):
            yield f"{{{what}}}{noun[0]}"
        last = text.values[i + 2] if after.value == " " and i + 2 < len(text.values) else None
        if isinstance(last, ast.FormattedValue) and "replace('_', ' ')" in ast.unparse(last.value):
            yield f"{{{what}}} {{{ast.unparse(last.value)}}}"


def _is_constant(node: ast.expr) -> bool:
    """Whether an expression is a number of the module, for example MAX_WORDS or wire.SAMPLES."""
    if isinstance(node, ast.BinOp):
        return _is_constant(node.left) and _is_constant(node.right)
    name = node.id if isinstance(node, ast.Name) else node.attr if isinstance(node, ast.Attribute) else ""
    return isinstance(node, ast.Constant) or name.strip("_").isupper()


def _compares_with_one(node: ast.AST) -> bool:
    return isinstance(node, ast.IfExp) and ast.unparse(node.test).endswith((" == 1", " > 1"))


def _appends_an_s(node: ast.expr) -> bool:
    """Whether a noun is made plural in place."""
    if isinstance(node, ast.IfExp):
        return {ast.unparse(node.body), ast.unparse(node.orelse)} == {"'s'", "''"}
    return isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mult) and ast.unparse(node.left) == "'s'"


@pytest.mark.parametrize("package", PACKAGES)
def test_no_noun_is_fixed_behind_a_number(package: str) -> None:
    modules = [path for path in sorted((ROOT / package).rglob("*.py")) if path.name != "texts.py"]
    found = [f"{path.relative_to(ROOT)}:{text}" for path in modules for text in fixed_nouns(path.read_text("utf-8"))]
    assert found == []


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ('f"{lost} samples lost"', 1),
        ('f"{len(rows)} index marks came twice"', 1),
        ('f"{count:9d} samples"', 1),
        ('''f"{n} {kind.replace('_', ' ')} lost"''', 1),
        ('''f"{n} port{'s' if n > 1 else ''}"''', 1),
        ('''f"{n} warning{'s' * (n > 1)}"''', 1),
        ('f"{_TRIES} samples"', 0),
        ('f"{share:.3g} samples a second"', 0),
        ('''f"{number_of(lost, 'sample')} lost"''', 0),
        ('f"a sample" if n == 1 else f"{n} samples"', 0),
        ('f"{name} has two tables"', 0),
    ],
)
def test_fixed_nouns_are_found(source: str, found: int) -> None:
    assert len(fixed_nouns(source)) == found


def test_a_noun_agrees_with_its_number() -> None:
    assert [number_of(n, "log") for n in (0, 1, 2)] == ["0 logs", "1 log", "2 logs"]
    assert number_of(1, "row is", "rows are") == "1 row is"
    assert number_of(1234, "sample ", "samples", "7,d") == "  1,234 samples"


def test_a_loss_agrees_with_its_number() -> None:
    words = [loss_words(n, kind) for kind in ("radio_frames", "damaged", "x_silent_ms") for n in (1, 2)]
    assert words == ["1 radio frame", "2 radio frames", "1 damaged", "2 damaged", "1 x silent ms", "2 x silent ms"]
