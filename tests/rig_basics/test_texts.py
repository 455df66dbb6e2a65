"""Numbers that are compared in a sentence differ in it as they do in the computation."""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Iterator
from pathlib import Path

from hypothesis import given, strategies as st

from rig_basics.texts import distinct

ROOT = Path(__file__).parents[2]
NUMBERS = st.floats(1e-6, 1e6)


def test_numbers_get_the_digits_that_show_which_is_larger() -> None:
    assert distinct(1.4, 3.0) == ("1.4", "3")
    assert distinct(1.349, 1.351) == ("1.3", "1.4")
    assert distinct(0.02999, 0.03) == ("0.02999", "0.03")
    assert distinct(0.030004, 0.03) == ("0.030004", "0.03")
    assert distinct(0.03, 0.03) == ("0.03", "0.03")
    assert distinct(149.96, 150.0, 3) == ("149.96", "150")


@given(NUMBERS, NUMBERS, st.integers(-4, 4))
def test_the_texts_are_in_the_order_of_the_numbers(one: float, other: float, ulps: int) -> None:
    near = one
    for _ in range(abs(ulps)):
        near = math.nextafter(near, math.copysign(math.inf, ulps))
    for value, limit in ((one, other), (one, near)):
        shown = [float(text) for text in distinct(value, limit)]
        assert (shown[0] < shown[1]) == (value < limit)
        assert (shown[0] > shown[1]) == (value > limit)


def rounded_comparisons(source: str) -> Iterator[int]:
    """Yield the lines of f-strings that state a rounded number and that another is needed."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.JoinedStr):
            words = "".join(str(part.value) for part in node.values if isinstance(part, ast.Constant))
            numbers = [part for part in node.values if isinstance(part, ast.FormattedValue)]
            specs = [ast.unparse(part.format_spec) for part in numbers if part.format_spec is not None]
            if (
                re.search(r"\bneeded\b", words)
                and any(re.search(r"\.\d+[fg]", spec) for spec in specs)
                and len(specs) > 1
            ):
                yield node.lineno


def test_no_sentence_compares_numbers_that_are_rounded_apart_from_each_other() -> None:
    found = {
        f"{path.relative_to(ROOT).as_posix()}:{line}"
        for package in sorted(path.parent for path in ROOT.glob("*/py.typed"))
        for path in sorted(package.rglob("*.py"))
        if "needed" in (source := path.read_text("utf-8"))
        for line in rounded_comparisons(source)
    }
    assert found == set()


def test_a_rounded_comparison_is_found() -> None:
    assert list(rounded_comparisons('text = f"only {span:.2g} s, {least:.2g} s are needed"')) == [1]
