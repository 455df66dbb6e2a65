"""Log times are unsigned in the format, and 2^63 ns is in the year 2262: later times come from a wrong clock."""

from __future__ import annotations

from pathlib import Path

import pytest
from mcap.writer import CompressionType, Writer

from daq.log import open_log
from rig_cli import main
from tests.daq.mcap.written import foreign


def write(path: Path, log_times_ns: list[int], **options: bool) -> Path:
    def fill(writer: Writer) -> None:
        channel = writer.register_channel("t", "json", 0)
        for number, time_ns in enumerate(log_times_ns):
            writer.add_message(channel, time_ns, b'{"a": 1}', 1, number)

    path.write_bytes(foreign(fill, compression=CompressionType.NONE, **options))
    return path


@pytest.mark.parametrize("index", [True, False])
@pytest.mark.parametrize("beyond", [2**63, 2**63 + 10, 2**64 - 1])
def test_log_times_that_no_signed_number_holds_are_counted(beyond: int, index: bool, tmp_path: Path) -> None:
    options = {} if index else {"use_chunking": False, "use_statistics": False}
    path = write(tmp_path / "late.mcap", [10**18, beyond, 2 * 10**18, beyond], **options)
    with open_log(path) as log:
        (missing,) = log.missing
    assert str(missing).startswith("2 messages with times of 2^63 ns or more")
    assert main.run(["log", str(path)]) == 1


def test_the_last_time_that_fits_is_read(tmp_path: Path) -> None:
    with open_log(write(tmp_path / "last.mcap", [10**18, 2**63 - 1])) as log:
        assert log.missing == []
