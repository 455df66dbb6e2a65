"""The Python shown in README and how-tos runs as it stands (what needs a log of the demo is left out)."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
EXAMPLES = [
    (page.name, code)
    for page in (ROOT / "README.md", *sorted((ROOT / "docs" / "how-to").glob("*.md")))
    for code in re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    if "out/demo" not in code
]


def test_there_are_examples() -> None:
    assert {name for name, _ in EXAMPLES} >= {"README.md", "analyst.md"}


@pytest.mark.parametrize(("name", "code"), EXAMPLES)
def test_example_runs(name: str, code: str, capsys: pytest.CaptureFixture[str]) -> None:
    exec(compile(code, name, "exec"), {})
    assert capsys.readouterr().out.strip()
