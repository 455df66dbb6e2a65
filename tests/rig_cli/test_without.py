"""`rig identify --without`: names, help and docs are of the same rungs."""

from __future__ import annotations

from pathlib import Path

import pytest

from identification.rungs import RUNGS
from rig_cli.offline import identify
from rig_cli.setting_costs import WITHOUT_HELP
from rig_configs import RigFileError

HOW_TO = Path(__file__).parents[2] / "docs" / "how-to" / "experimenter" / "exclude_an_effect.md"


def test_help_and_how_to_name_every_rung() -> None:
    page = HOW_TO.read_text(encoding="utf-8")
    for rung, words in RUNGS.items():
        assert rung in WITHOUT_HELP
        assert f"| `{rung}` | {words} |" in page


def test_an_unknown_rung_is_refused_before_a_log_is_read(tmp_path: Path) -> None:
    with pytest.raises(RigFileError, match=r"--without: rungs: expected some of lines.*got colour"):
        identify(tmp_path / "no.mcap", output=tmp_path / "p.toml", without=["colour"])
