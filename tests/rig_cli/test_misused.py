"""What is expected of options that are not there: in a terminal and in JSON."""

from __future__ import annotations

import json

import pytest

from rig_cli.main import run


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["test", "virtual", "-o", "logs"], "Unknown option: -o. Did you mean --out?"),
        (["test", "virtual", "--outt", "logs"], "Did you mean --out?"),
        (["plot", "bode", "a.mcap", "-m", "parameters.toml"], "Unknown option: -m. Did you mean --model?"),
        (["plot", "bode", "a.mcap", "-z"], "Unknown option: -z."),
    ],
)
def test_an_option_that_is_not_there_names_the_likely_one(
    words: list[str], expected: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(words) == 2
    shown = capsys.readouterr()
    assert expected in " ".join(shown.err.replace("│", " ").split())
    assert ("Did you mean" in shown.err) == ("Did you mean" in expected)
    assert run([*words, "--json"]) == 2
    assert expected in json.loads(capsys.readouterr().out)["error"]
