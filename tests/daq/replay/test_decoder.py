"""The decoder that a log states: recorded logs and new ones have it, and a check names another one as the cause."""

from __future__ import annotations

from pathlib import Path

import pytest

from daq.items import Batch, DeviceEvent
from daq.log import open_log
from daq.replay import check
from daq.replay.decoded_again import decode_again
from daq.version import DECODER
from tests.daq.replayed_log import as_it_is, write_log
from tests.daq.simulated_sessions import recorded_at_rest

OTHER = DECODER + 1
EXPECTED = f"decoded again by decoder {DECODER}: differences are expected"


def test_a_recorded_log_states_its_decoder(tmp_path: Path) -> None:
    recorded_at_rest(Path("virtual"), tmp_path / "a.mcap", seconds=0.5)
    with open_log(tmp_path / "a.mcap") as log:
        assert log.metadata["run"]["decoder"] == str(DECODER)
    found = check(tmp_path / "a.mcap")
    assert found.identical
    assert (found.recorded_by, found.decoded_by) == (DECODER, DECODER)
    assert not [note for note in found.notes if "decoder" in note]


@pytest.mark.parametrize("differs", [False, True])
def test_a_log_of_another_decoder_is_decoded_and_the_decoder_is_named(tmp_path: Path, differs: bool) -> None:
    def later(number: int, item: Batch | DeviceEvent, host_ns: int) -> tuple[Batch | DeviceEvent, int]:
        if not isinstance(item, Batch) or number % 50:
            return item, host_ns
        return Batch(item.channel, item.time_ns + 1, item.sequence, item.columns), host_ns

    path = write_log(tmp_path / "a.mcap", steps=20, falsify=later if differs else as_it_is, decoder=str(OTHER))
    found = check(path)
    assert found.identical is not differs, "another decoder is no excuse for a difference, only its cause"
    assert found.notes == (f"recorded by decoder {OTHER}, {EXPECTED}",)
    assert (found.recorded_by, found.decoded_by) == (OTHER, DECODER)


@pytest.mark.parametrize("fact", [None, "", "0", "-1", "1.0", " 1", "1\n", "two", "²", "٣", "9" * 5000])
def test_a_log_without_a_usable_fact_was_recorded_by_an_unknown_decoder(tmp_path: Path, fact: str | None) -> None:
    found = check(write_log(tmp_path / "a.mcap", steps=3, decoder=fact))
    assert found.identical
    assert found.recorded_by is None
    assert found.notes == (f"recorded by an unknown decoder, {EXPECTED}",)


def test_a_new_log_states_the_decoder_that_made_it(tmp_path: Path) -> None:
    made = decode_again(write_log(tmp_path / "a.mcap", steps=3, decoder=str(OTHER)), tmp_path / "b.mcap")
    assert check(made.path).recorded_by == DECODER
