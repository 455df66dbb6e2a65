"""optoNCDT 2300 on Ethernet: packets, losses by the counter, identity, and a session in lockstep."""

from __future__ import annotations

import struct
from dataclasses import asdict
from importlib import resources
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from hypothesis import given, strategies as st
from pydantic import ValidationError

import rig_testing
from daq.acquisition.session import Session
from daq.channels import displacement_channel
from daq.drivers.optoncdt_ethernet import wire
from daq.drivers.optoncdt_ethernet.driver import EthernetDriver
from daq.drivers.optoncdt_ethernet.settings import EthernetLaser
from daq.drivers.optoncdt_ethernet.stream import EthernetPipeline
from daq.items import RX, TX, Batch, DeviceEvent
from daq.lockstep.rig import LockstepRig
from daq.log import open_log
from daq.replay import check
from rig_configs import load_rig
from tests.daq.kit_cases import kit_cases

S = 1_000_000_000
HEADER = struct.Struct("<IIIIIHHI")


def settings(**more: Any) -> EthernetLaser:
    return EthernetLaser.model_validate({"driver": "optoncdt_ethernet", "port": "socket://x:1", "axis": "x", **more})


def pipeline(**more: Any) -> EthernetPipeline:
    return EthernetPipeline("laser", settings(**more), displacement_channel("laser/x"), {})


def packet(counter: int, codes: list[int], serial: int = 77) -> bytes:
    return wire.encode(wire.Packet(4120175, serial, (1, 0), counter, np.array(codes, np.uint32)[:, None]))


def kinds(items: list[Batch | DeviceEvent]) -> list[str]:
    return [item.kind for item in items if isinstance(item, DeviceEvent)]


def test_a_packet_is_read_word_by_word_in_either_order_of_its_sizes() -> None:
    """Written here by hand: the figures of the manual disagree on which size is first."""
    words = struct.pack("<6I", 32760, 1, 2, 655, 3, 4)
    for sizes in ((2, 12), (12, 2)):
        data = HEADER.pack(0x4D454153, 4120175, 77, 0x7, 0x0, *sizes, 99) + words
        found = wire.PacketDecoder(3).feed(b"\x00SAE" + data)
        (one,) = found.packets
        assert (one.order, one.serial, one.flags, one.counter) == (4120175, 77, (7, 0), 99)
        assert one.frames.tolist() == [[32760, 1, 2], [655, 3, 4]]
        assert found.skipped_bytes == 4
    assert data[:4] == b"SAEM"


def test_a_header_with_impossible_sizes_is_skipped_byte_by_byte() -> None:
    good = packet(5, [1, 2])
    for sizes in ((0, 4), (3, 8), (8193, 4)):
        bad = HEADER.pack(wire.PREAMBLE, 1, 2, 3, 4, *sizes, 5)
        found = wire.PacketDecoder(1).feed(bad + good)
        assert [p.counter for p in found.packets] == [5]
        assert found.skipped_bytes == wire.HEADER_BYTES


@given(
    st.lists(st.integers(1, 40), min_size=1, max_size=5),
    st.lists(st.integers(0, 400), max_size=6),
    st.binary(max_size=9),
)
def test_any_split_gives_the_same_packets(counts: list[int], cuts: list[int], noise: bytes) -> None:
    rng = np.random.default_rng(len(counts))
    sent = [wire.Packet(1, 2, (3, 4), n, rng.integers(0, 2**32, (n, 2), np.uint32)) for n in counts]
    data = (noise if b"S" not in noise else b"") + b"".join(map(wire.encode, sent))
    decoder, found, skipped = wire.PacketDecoder(2), list[wire.Packet](), 0
    places = [0, *sorted(min(cut, len(data)) for cut in cuts), len(data)]
    for begin, end in pairwise(places):
        part = decoder.feed(data[begin:end])
        found += part.packets
        skipped += part.skipped_bytes
    assert [p.counter for p in found] == counts
    assert all(np.array_equal(a.frames, b.frames) for a, b in zip(found, sent, strict=True))
    assert skipped == len(data) - sum(len(wire.encode(p)) for p in sent)


def test_a_distance_is_signed_nanometres_and_the_largest_numbers_are_error_codes() -> None:
    """The maker's manual of the optoNCDT 2300, value output by Ethernet: a wrong reading is 300 times too large."""
    line = pipeline(range_m=0.02)
    codes = [10_000_000, 0, 20_000_000, 2**32 - 100_000]
    (batch,) = line.feed(RX, packet(0, codes + list(range(0x7FFF_FFF5, 0x7FFF_FFFC))), S)
    assert isinstance(batch, Batch)
    found = batch.columns["displacement_m"]
    assert found[:4] == pytest.approx([0.0, -0.01, 0.01, -0.0101], abs=1e-12)
    assert np.isnan(found[4:]).all()
    assert line.losses["invalid"] == 7


def test_words_of_the_serial_line_become_displacements_by_its_formula() -> None:
    line = pipeline(range_m=0.01, lever_ratio=2.0, scaling="ILD1420")
    (batch,) = line.feed(RX, packet(0, [32760, 642, 262076]), S)
    assert isinstance(batch, Batch)
    found = batch.columns["displacement_m"]
    assert found[:2] == pytest.approx([0.0, -0.0025], abs=1e-6)
    assert np.isnan(found[2])
    assert batch.columns["code"].tolist() == [32760, 642, 262076]
    assert line.losses == {"samples": 0, "bytes": 0, "invalid": 1}


def test_missing_frames_are_counted_exactly_and_keep_their_time() -> None:
    line = pipeline(rate_Hz=1000.0)
    line.feed(RX, packet(2**32 - 2, [1, 2, 3]), S)
    gap, batch = line.feed(RX, packet(11, [4, 5]), S + 15_000_000)
    assert isinstance(gap, DeviceEvent)
    assert isinstance(batch, Batch)
    assert (gap.kind, gap.facts["samples"], gap.facts["span_s"]) == ("gap", 10, pytest.approx(0.01))
    assert batch.columns["counter"].tolist() == [11, 12]
    first = 100 * (2**32 + 11)
    assert batch.columns["device_ticks"].tolist() == [first, first + 100]
    assert line.losses["samples"] == 10


def test_a_counter_of_packets_gives_about_the_number_of_lost_samples() -> None:
    line = pipeline(counts="packets")
    assert line.clock_seed is None
    line.feed(RX, packet(7, [1, 2]), S)
    assert kinds(line.feed(RX, packet(8, [3, 4, 5]), S + 1000)) == []
    (gap, _) = line.feed(RX, packet(11, [6, 7]), S + 2000)
    assert isinstance(gap, DeviceEvent)
    assert (gap.facts["samples"], gap.facts["uncertain_samples"]) == (4, 2)


def test_a_counter_that_steps_back_is_a_restart() -> None:
    line = pipeline()
    line.feed(RX, packet(1000, [1, 2]), S)
    assert kinds(line.feed(RX, packet(0, [3]), 2 * S)) == ["restart"]
    assert line.losses["samples"] == 0


def test_another_sensor_gives_no_samples() -> None:
    line = pipeline(serial=78)
    assert line.has_reported is False
    assert kinds(line.feed(RX, packet(0, [1]), S)) == ["fault"]
    assert line.has_reported
    assert "serial number 77, expected 78" in line.complaint
    assert line.feed(RX, packet(1, [1]), S) == []
    (batch,) = line.feed(RX, packet(2, [1], serial=78), 2 * S)
    assert isinstance(batch, Batch)
    assert line.complaint == ""
    assert line.learned == {"order": 4120175, "serial": 78}
    assert line.feed(TX, packet(3, [1]), 3 * S) == []


def test_a_sensor_that_takes_the_place_of_another_gives_no_samples() -> None:
    """In the same log, and in the next one of the session."""
    line = pipeline()
    line.feed(RX, packet(0, [1]), S)
    assert kinds(line.feed(RX, packet(1, [1], serial=78), S)) == ["fault"]
    assert len(line.feed(RX, packet(1, [1]), S)) == 1
    later = EthernetPipeline("laser", settings(), displacement_channel("laser/x"), {"serial": 77})
    assert kinds(later.feed(RX, packet(1, [1], serial=78), S)) == ["fault"]


@pytest.mark.parametrize("wait_s", [0.2, 2.0, 100.0])
def test_the_next_log_continues_the_clock(wait_s: float) -> None:
    """Its first read arrives late: by the state of the clock before, its samples keep their time."""
    line = pipeline(rate_Hz=1000.0)
    for i in range(100):
        line.feed(RX, packet(10 * i, [1] * 10), S + i * 10_000_000)
    seed = line.clock_seed
    assert seed is not None
    identity = {"serial": 77, "clock_seed": asdict(seed)}
    later = EthernetPipeline("laser", settings(rate_Hz=1000.0), displacement_channel("laser/x"), identity)
    number = 1000 + round(1000 * wait_s)
    true_ns = S + (number - 9) * 1_000_000
    (batch,) = later.feed(RX, packet(number, [1]), true_ns + 30_000_000)
    assert isinstance(batch, Batch)
    assert batch.time_ns.tolist() == [pytest.approx(true_ns, abs=1_000_000)]


@pytest.mark.parametrize("words", [(), ("COUNTER",), ("DIST", "DIST"), ("DIST", "COUNTER", "COUNTER")])
def test_words_without_one_distance_are_refused(words: tuple[str, ...]) -> None:
    with pytest.raises(ValidationError, match="words"):
        settings(words=words)


class _Three(EthernetDriver):
    example: ClassVar = {"axis": "y", "words": ["SHUTTER", "INTENSITY", "DIST"], "scaling": "ILD1900", "serial": 12}


class _Packets(EthernetDriver):
    example: ClassVar = {"axis": "x", "counts": "packets", "rate_Hz": 20_000.0}
    claims = frozenset[str]()


KINDS = (_Three, _Packets)


@pytest.mark.parametrize("case", kit_cases(KINDS))
def test_every_set_up_passes_the_tests_of_drivers(case: rig_testing.ContractCase) -> None:
    case()


def test_a_session_records_it_and_decodes_its_log_again(tmp_path: Path) -> None:
    table = '\n[devices.net]\ndriver = "optoncdt_ethernet"\nport = "p"\naxis = "y"\nwitness = "net"\nrate_Hz = 2000\n'
    file = tmp_path / "rig.toml"
    file.write_text((resources.files("rig_configs") / "virtual.toml").read_text() + table)
    sim = LockstepRig(load_rig(file, settings=["virtual.seed=4"]))
    session = Session(load_rig(file, settings=["virtual.seed=4", *sim.port_settings()]), sim.clock, edge=sim.edge)
    with session:
        session.start_recording(tmp_path / "a.mcap", {"test": "record"})
        sim.clock.sleep(3.0)
        session.stop_recording({})
        losses = session.losses()["net"]
    assert [row.topic for row in check(tmp_path / "a.mcap") if row.difference] == []
    with open_log(tmp_path / "a.mcap") as log:
        assert len(log["laser/net"]) == pytest.approx(6000, abs=60)
    assert set(losses.values()) == {0}


# --- a scaling that cannot be right ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("scaling", "word", "remedy"), [("nm", 32_760, 'scaling = "ILD1420"'), ("ILD1420", 10_000_000, 'scaling = "nm"')]
)
def test_words_of_the_other_scaling_give_a_fault_and_no_more_samples(scaling: str, word: int, remedy: str) -> None:
    line = pipeline(range_m=0.02, scaling=scaling)
    for number in range(11):
        items = line.feed(RX, packet(100 * number, [word + number] * 100), number * S // 50)
    assert kinds(items) == []
    assert remedy in line.complaint
    assert not [item for item in items if isinstance(item, Batch)]


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"range_m": 0.02, "scaling": "nm"}, [10_000_000] * 1100),
        ({"range_m": 0.02, "scaling": "nm"}, [32_760] * 999 + [-5] * 101),
        ({"range_m": 0.02, "scaling": "nm"}, [0x7FFF_FFFB] * 1100),
        ({"range_m": 0.02, "scaling": "ILD1420"}, [32_760] * 1100),
        ({"range_m": 0.02, "scaling": "ILD1420"}, [262_076] * 1100),
        ({"range_m": 0.001, "scaling": "nm"}, [50_000] * 1100),
    ],
)
def test_words_that_fit_their_scaling_are_no_fault(more: dict[str, Any], words: list[int]) -> None:
    line = pipeline(**more)
    for at in range(0, 1100, 100):
        codes = [word % 2**32 for word in words[at : at + 100]]
        line.feed(RX, packet(at, codes), at * S // 5000)
    assert line.complaint == ""
