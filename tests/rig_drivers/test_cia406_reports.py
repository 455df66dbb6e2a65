"""Set-up of the reports of CANopen encoders that refuse parts of it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from daq.errors import DeviceError
from daq.items import RX, TX, Batch
from rig_drivers.cia406.far_end import PlayedEncoders
from rig_drivers.cia406.stream import EncoderPipeline
from rig_testing.bench import DriverBench
from tests.daq.can_text import rx, tx
from tests.rig_drivers.test_cia406 import SYNC, bench_of, identity, settings

POSITION, SPEED = 0x6004_0020, 0x6030_0110


def with_encoder(
    fixed: set[tuple[int, int]], mapped: list[int] | None = None, kind: int = 254, **other: Any
) -> DriverBench:
    """Encoders of which B refuses to change some objects, with a mapping and a transmission type of TPDO1."""
    bench, far = bench_of(**other)
    encoder = far.encoders[1]
    encoder.fixed.update(fixed)
    encoder.objects[0x6030, 1] = (0x1234, "<H")
    encoder.objects[0x1800, 2] = (kind, "<B")
    for sub, entry in enumerate(mapped or [], 1):
        encoder.objects[0x1A00, sub] = (entry, "<I")
    encoder.objects[0x1A00, 0] = (len(mapped or [1]), "<B")
    return bench


def objects_of(bench: DriverBench) -> dict[tuple[int, int], int]:
    far: Any = bench.far
    return {place: value for place, (value, _) in far.encoders[1].objects.items() if 0x1800 <= place[0] < 0x1B00}


FIXED_MAPPING = {(0x1A00, 0), (0x1A00, 1), (0x1A00, 2)}


@pytest.mark.parametrize(
    ("bench", "words"),
    [
        (with_encoder({(0x1800, 2)}), "encoder b: refused 1 at 1800h sub 2.*type 254.*Set sync = false"),
        (with_encoder({(0x1800, 2)}, kind=1, sync=False, rate_Hz=100), "type 1,.*Set sync = true"),
        (with_encoder({(0x6200, 0)}, sync=False, rate_Hz=100), "refused 10 at 6200h.*Reduce rate_Hz"),
        (
            with_encoder(FIXED_MAPPING, [SPEED]),
            "refused 0 at 1A00h.*contains 6030h sub 1, 16 bits: expected the position",
        ),
        (with_encoder(FIXED_MAPPING, [0x2000_0004, POSITION]), "contains 2000h sub 0, 4 bits . 6004h sub 0, 32 bits"),
    ],
)
def test_a_refusal_has_a_remedy_and_leaves_the_reports_as_they_were(bench: DriverBench, words: str) -> None:
    before = objects_of(bench)
    with pytest.raises(DeviceError, match=words):
        bench.begin()
    assert objects_of(bench) == before


@pytest.mark.parametrize(
    ("mapped", "fixed", "offset"),
    [
        ([POSITION, SPEED], FIXED_MAPPING, 0),
        ([SPEED, POSITION], FIXED_MAPPING, 2),
        ([SPEED, POSITION], {(0x1A00, 1)}, 2),  # refused after the mapping was switched off
        ([SPEED, POSITION], set[tuple[int, int]](), 0),
    ],
)
def test_a_fixed_mapping_with_the_position_is_accepted(
    mapped: list[int], fixed: set[tuple[int, int]], offset: int
) -> None:
    bench = with_encoder(fixed, mapped)
    bench.begin()
    bench.clock.wait(0.3)
    assert bench.identity["b_offset"] == offset
    assert objects_of(bench)[0x1A00, 0] == (2 if fixed else 1)
    assert bench.pipeline.losses["invalid"] == 0
    counts = np.concatenate(
        [i.columns["count_b"] for i in bench.items if isinstance(i, Batch) and "count_b" in i.columns]
    )
    far: Any = bench.far
    assert len(counts) > 20
    assert int(counts[-1]) % 4096 == far.encoders[1]._position % 4096


def test_a_transmission_type_that_is_right_is_not_written() -> None:
    bench = with_encoder({(0x1800, 2)}, kind=1)
    bench.begin()


def test_the_stand_in_for_a_log_keeps_the_place_of_the_position() -> None:
    played = PlayedEncoders(settings(), {**identity(), "b_offset": 2})
    played.hear(tx(b"O\r"))
    assert played.hear(tx(b"t604840001A0000000000\r")) == rx(b"t58484F001A0002000000\r")
    assert played.hear(tx(b"t60482F001A0000000000\r"))[:4] == rx(b"t584880001A0000000000\r")[:4]
    assert played.hear(tx(b"t604840001A0100000000\r")) == rx(b"t584843001A0110000020\r")


def test_reports_are_decoded_at_the_place_in_the_identity() -> None:
    pipeline = EncoderPipeline("encoders", settings(shaft_node=None), {**identity(), "b_offset": 2})
    pipeline.feed(TX, SYNC, 0)
    items = pipeline.feed(RX, rx(b"t183401000000\rt184634120A000000\r"), 1_000_000)
    (batch,) = [item for item in items if isinstance(item, Batch)]
    assert int(batch.columns["count_b"][0]) == 10
    (event,) = pipeline.feed(RX, rx(b"t18440A000000\r"), 2_000_000)
    assert "a report of 4 bytes, expected 6" in str(event)


@pytest.mark.parametrize("offset", [-1, 5, "2", 1.0])
def test_an_impossible_place_is_refused(offset: object) -> None:
    with pytest.raises(DeviceError, match="encoder b: expected a place of the position from 0 to 4 bytes"):
        EncoderPipeline("encoders", settings(), {"b_offset": offset})
