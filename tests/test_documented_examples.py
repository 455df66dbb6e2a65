"""The Python shown in README and how-tos runs as it stands.

Examples that read a demo's files run in a folder that contains out/demo:

    python -m tests.test_documented_examples
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SHOWN = [
    (page.relative_to(ROOT).as_posix(), code)
    for page in (ROOT / "README.md", *sorted((ROOT / "docs" / "how-to").rglob("*.md")))
    for code in re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
]
EXAMPLES = [(name, code) for name, code in SHOWN if "out/demo" not in code]


def test_there_are_examples() -> None:
    assert "README.md" in {name for name, _ in SHOWN}
    assert {Path(name).stem for name, _ in EXAMPLES} >= {"simulate_in_python", "script_a_campaign"}


@pytest.mark.parametrize(("name", "code"), EXAMPLES)
def test_example_runs(name: str, code: str, capsys: pytest.CaptureFixture[str]) -> None:
    exec(compile(code, name, "exec"), {})
    assert capsys.readouterr().out.strip()


def run_examples_on_a_demo() -> int:
    """Run the examples that read out/demo of the present folder, and return their number."""
    examples = [(name, code) for name, code in SHOWN if "out/demo" in code]
    for name, code in examples:
        print(f"example of {name}", flush=True)
        exec(compile(code, name, "exec"), {})
    return len(examples)


if __name__ == "__main__":
    assert run_examples_on_a_demo() > 1, "README shows examples with the demo's files"
