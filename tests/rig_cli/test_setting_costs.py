"""Help texts of settings and docs/benchmarks.md agree: both come from one table."""

from __future__ import annotations

from pathlib import Path

import pytest

from rig_cli import setting_costs
from rig_cli.main import run
from rig_cli.setting_costs import COSTS, TRACKING

PAGE = (Path(__file__).parents[2] / "docs" / "benchmarks.md").read_text(encoding="utf-8")


def test_the_page_holds_the_table_the_help_is_made_of() -> None:
    for cost in COSTS:
        low, high = (f"{error:.3g}" for error in cost.error)
        error = low if low == high else f"{low} to {high}"
        line = f"| {cost.service} | {cost.setting} | {cost.time:.3g} | {error} | {cost.cases} | {cost.records} |"
        assert line in PAGE
    t = TRACKING
    assert f"| {t.log} | {t.fast_ms:.0f} ms | {t.ratio:.0f} | {t.rates:.2g} | {t.damping:.2g} |" in PAGE
    for text in (setting_costs.COMMAND, setting_costs.TRACKING_COMMAND.removesuffix(" LOG"), setting_costs.MACHINE):
        assert text in PAGE


@pytest.mark.parametrize(
    ("command", "figures"), [("identify", ["0.036 to 1.2", "1.7 to 65"]), ("track", ["8 ms", "69"])]
)
def test_help_states_cost_and_gain(capsys: pytest.CaptureFixture[str], command: str, figures: list[str]) -> None:
    assert run([command, "--help"]) == 0
    text = " ".join(capsys.readouterr().out.replace("│", " ").split())
    for figure in figures:
        assert f"{figure} " in text
    assert "docs/benchmarks.md" in text
