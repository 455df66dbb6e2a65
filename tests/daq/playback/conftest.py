"""The log that is played."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from daq.log import Log, open_log
from tests.daq.replayed_log import write_log


@pytest.fixture
def log(tmp_path: Path) -> Iterator[Log]:
    with open_log(write_log(tmp_path / "a.mcap")) as opened:
        yield opened
