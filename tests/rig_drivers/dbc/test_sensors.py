"""Sensors on CAN described by a DBC file: signals as cantools decodes them, times and losses, hostile files, replay."""

from __future__ import annotations

import contextlib
import copy
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any

import cantools
import numpy as np
import pytest
from hypothesis import given, settings as budget, strategies as st
from pydantic import ValidationError

import rig_testing
from daq.acquisition.session import Session
from daq.items import RX, TX, Batch, DeviceEvent
from daq.lockstep.rig import LockstepRig
from daq.log import open_log
from daq.replay import check
from daq.replay.calibration import Calibration
from daq.transports.can_frames import AdapterMessage, CanFrame, adapter_message, encode
from rig_configs import RigFileError, load_rig
from rig_drivers.dbc import layouts
from rig_drivers.dbc.driver import DRIVER
from rig_drivers.dbc.example import DBC, SETTINGS
from rig_drivers.dbc.layouts import database, message
from rig_drivers.dbc.settings import CanSensors
from rig_drivers.dbc.stream import CanPipeline
from rig_testing.bench import DriverBench
from tests.daq.can_text import rx
from tests.daq.kit_cases import kit_cases

MS = 1_000_000
Items = list[Batch | DeviceEvent]


def table(**changes: Any) -> dict[str, Any]:
    """The example's settings; "x__rate_Hz" is a key of the table x, None removes a key."""
    found: dict[str, Any] = {"driver": "dbc", "port": "p", **copy.deepcopy(SETTINGS)}
    found["x"]["rate_Hz"] = 2000.0
    for key, value in changes.items():
        *path, name = key.split("__")
        inner = found
        for part in path:
            inner = inner[part]
        inner[name] = value
        if value is None:
            del inner[name]
    return found


def sensors(**changes: Any) -> CanSensors:
    return CanSensors.model_validate(table(**changes))


def pipeline(**changes: Any) -> Any:
    return DRIVER.pipeline("bus", sensors(**changes), {})


def frame(name: str, **raw: Any) -> bytes:
    """A frame that cantools encodes from raw numbers."""
    found = database(DBC).get_message_by_name(name)
    values = {signal.name: 0 for signal in found.signals} | raw
    return encode(CanFrame(found.frame_id, found.encode(values, scaling=False, strict=False), found.is_extended_frame))


def x_frames(first: int, count: int, time_us: int = 0) -> bytes:
    return b"".join(
        frame("LaserX", Distance=10_000, Count=(first + i) % 256, Time=time_us + 500 * i) for i in range(count)
    )


def batches(items: Items, topic: str) -> list[Batch]:
    return [item for item in items if isinstance(item, Batch) and item.channel.topic == topic]


def kinds(items: Items) -> list[str]:
    return [item.kind for item in items if isinstance(item, DeviceEvent)]


# --- signals -----------------------------------------------------------------------------------------------------


@st.composite
def files(draw: st.DrawFn) -> str:
    """A message with signals of any place, order, sign and scale, and multiplexed ones in the last two bytes."""
    lines, at = ["BO_ 100 M: 8 N"], 0
    orders = draw(st.lists(st.booleans(), min_size=1, max_size=3))
    for number, big in enumerate(orders):
        length = draw(st.integers(1, 16))
        start = 8 * (at // 8) + 7 - at % 8 if big else at
        if big and number and not orders[number - 1]:  # the first whole byte behind signals of the other order
            at = -(-at // 8) * 8
            start = at + 7
        elif not big and number and orders[number - 1]:
            start = at = -(-at // 8) * 8
        if at + length > 48:
            break
        sign, scale = draw(st.sampled_from("+-")), draw(st.sampled_from(["1", "0.1", "0.001", "-2.5", "3"]))
        offset = draw(st.sampled_from(["0", "-40", "12.5"]))
        lines.append(f' SG_ S{number} : {start}|{length}@{0 if big else 1}{sign} ({scale},{offset}) [0|0] "mm" N')
        at += length
    lines += [' SG_ Page M : 48|4@1+ (1,0) [0|0] "" N', ' SG_ P0 m0 : 52|12@1- (0.5,1) [0|0] "" N']
    lines += [' SG_ P1 m1 : 56|8@1+ (1,0) [0|0] "" N']
    return "\n".join(['VERSION ""', "NS_ :", "BS_:", "BU_: N", *lines, ""])


@budget(deadline=None)
@given(files(), st.lists(st.binary(min_size=8, max_size=8), min_size=1, max_size=5))
def test_all_signals_are_decoded_as_cantools_decodes_them(text: str, frames: list[bytes]) -> None:
    reference: Any = cantools.database.load_string(text, "dbc")
    reference = reference.get_message_by_name("M")
    layout = message(text, "M")
    data = np.frombuffer(b"".join(frames), np.uint8).reshape(-1, 8)
    for row, each in enumerate(frames):
        page = each[6] & 0xF
        expected: dict[str, Any] = {}
        raw: dict[str, Any] = {}
        if page in (0, 1):
            expected = reference.decode(each, decode_choices=False)
            raw = reference.decode(each, decode_choices=False, scaling=False)
        for name, signal in layout.signals.items():
            present = bool(signal.present(data)[row])
            if page in (0, 1):
                assert present == (name in expected)
            if present and name in expected:
                assert signal.values(data)[row] == pytest.approx(expected[name], rel=1e-12, abs=1e-12)
                assert signal.raw(data)[row] == raw[name]


@pytest.mark.parametrize(("bits", "kind"), [(32, 1), (64, 2)])
def test_floats_and_numbers_of_64_bits_are_read(bits: int, kind: int) -> None:
    text = f'VERSION ""\nBU_: N\nBO_ 1 M: 8 N\n SG_ F : 0|{bits}@1- (2,1) [0|0] "m" N\nSIG_VALTYPE_ 1 F : {kind};\n'
    data = np.array([1.25], f"<f{bits // 8}").tobytes().ljust(8, b"\0")
    signal = message(text, "M").signals["F"]
    assert signal.values(np.frombuffer(data, np.uint8).reshape(1, 8)).tolist() == [3.5]
    whole = message(text.replace("SIG_VALTYPE_", "CM_ SG_").replace(f": {kind};", '"t";').replace("@1-", "@1+"), "M")
    many = np.full((1, 8), 0xFF, np.uint8)
    assert whole.signals["F"].values(many).tolist() == [2.0 * (2**bits - 1) + 1]


def test_a_frame_written_by_hand_gives_both_displacements() -> None:
    """LaserX: 10 000 · 0.1 µm, little-endian; LaserY: 15 000 · 0.5 µm big-endian, from 16 mm towards the sensor."""
    line = pipeline(x__lever_ratio=2.0)
    data = b"t1008102700070100" + b"0000\r" + b"T0000020063A980090FFFF\r"
    found = line.feed(RX, rx(data), 1000 * MS)
    (x,), (y,) = batches(found, "laser/x"), batches(found, "laser/y")
    assert x.columns["displacement_m"].tolist() == [pytest.approx(0.5e-3)]
    assert (x.columns["counter"].tolist(), x.columns["code"].tolist()) == ([7], [10_000])
    assert y.columns["displacement_m"].tolist() == [pytest.approx(8.5e-3)]
    assert (y.columns["counter"].tolist(), y.columns["code"].tolist()) == ([9], [15_000])
    assert set(line.losses.values()) == {0}


def test_a_value_without_a_reading_or_beyond_the_range_is_not_a_number() -> None:
    line = pipeline(x__range_m=0.01, x__invalid=["NoTarget", 77])
    raw = [8388607, 77, 50_001, -50_001, 50_000]
    found = line.feed(RX, b"".join(frame("LaserX", Distance=r, Count=i, Time=500 * i) for i, r in enumerate(raw)), 0)
    (x,) = batches(found, "laser/x")
    assert np.isnan(x.columns["displacement_m"]).tolist() == [True, True, True, True, False]
    assert line.losses["invalid"] == 4


def test_multiplexed_quantities_have_the_signals_of_each_frame() -> None:
    line = pipeline(quantities__temperatures__timeout_s=0.5)
    found = line.feed(RX, frame("Status", HeadTemperature=215) + frame("Status", Page=1, BoardTemperature=-5), 7 * MS)
    (batch,) = batches(found, "can/temperatures")
    assert batch.time_ns.tolist() == [7 * MS, 7 * MS]
    np.testing.assert_allclose(batch.columns["head_degC"], [21.5, np.nan])
    np.testing.assert_allclose(batch.columns["board_degC"], [np.nan, -0.5])
    assert batches(line.feed(RX, encode(CanFrame(768, b"\x02\0\0\0")), 8 * MS), "can/temperatures") == []
    foreign = encode(CanFrame(0x7E5, b"\x01"))
    assert kinds(line.feed(RX, foreign, 400 * MS)) == []
    assert kinds(line.feed(RX, foreign, 600 * MS)) == ["fault"]  # the lasers have not sent either, for less than 1 s


# --- times and losses --------------------------------------------------------------------------------------------


def test_a_cycle_of_the_counter_that_is_lost_whole_is_counted() -> None:
    """8 bits at 2 kHz begin again after 0.128 s; 300 lost frames are 44 and a whole cycle."""
    line = pipeline(quantities={}, y=None)
    for i in range(20):
        line.feed(RX, x_frames(20 * i, 20, 10_000 * i), 1000 * MS + 10 * i * MS)
    found = line.feed(RX, x_frames(400 + 300, 20, 500 * 700), 1000 * MS + 350 * MS)
    assert kinds(found) == ["gap"]
    assert line.losses["samples"] == 300
    (x,) = batches(found, "laser/x")
    assert np.diff(x.columns["device_ticks"]).tolist() == [50] * 19
    assert x.columns["device_ticks"][0] == 50 * 700


@pytest.mark.parametrize("lost", [255, 256, 300, 700])
def test_the_timestamp_shows_a_lost_cycle_that_the_host_cannot_see(lost: int) -> None:
    """At 4 kHz the counter begins again every 64 ms; after 255 lost frames its number is that of the frame before."""
    line = pipeline(quantities={}, y=None, x__rate_Hz=4000.0, bitrate=1_000_000)
    found: Items = []
    for first in (*range(20, 4020, 40), *range(4020 + lost, 8020 + lost, 40)):
        numbers = range(first, first + 40)
        frames = b"".join(frame("LaserX", Distance=10_000, Count=n % 256, Time=250 * n) for n in numbers)
        found += line.feed(RX, frames, 500 * MS + 250_000 * numbers[-1] + 5 * MS * (first % 3))
    assert kinds(found) == ["gap"]
    assert line.losses["samples"] == lost
    counted = np.concatenate([batch.sequence for batch in batches(found, "laser/x")])
    assert len(counted) == 8000
    assert int(counted[-1]) - int(counted[0]) == 7999 + lost


def test_a_number_that_cannot_be_right_gives_no_sample_and_one_that_goes_on_is_a_restart() -> None:
    line = pipeline(quantities={}, y=None)
    for i in range(20):
        line.feed(RX, x_frames(20 * i, 20, 10_000 * i), 1000 * MS + 10 * i * MS)
    damaged = frame("LaserX", Distance=1, Count=(400 + 128) % 256, Time=500 * 400)
    found = line.feed(RX, damaged + x_frames(401, 19, 500 * 401), 1200 * MS)
    assert kinds(found) == ["damage", "gap"]
    assert (line.losses["doubtful_frames"], line.losses["samples"]) == (1, 1)
    assert len(batches(found, "laser/x")[0].time_ns) == 19
    found = line.feed(RX, x_frames(148 + 100, 20, 7_000_000), 1210 * MS)
    assert "restart" in kinds(found)
    assert len(batches(found, "laser/x")[0].time_ns) >= 18


def test_samples_without_counter_and_timestamp_have_the_times_of_their_reads() -> None:
    line = pipeline(quantities={}, y=None, x__counter=None, x__timestamp=None)
    (first,) = batches(line.feed(RX, x_frames(0, 3), 1000 * MS), "laser/x")
    assert first.time_ns.tolist() == [999 * MS, 999 * MS + MS // 2, 1000 * MS]
    (second,) = batches(line.feed(RX, x_frames(9, 4), 1001 * MS), "laser/x")
    assert np.all(np.diff([*first.time_ns, *second.time_ns]) > 0)
    assert line.status.clock_seed is None
    assert DRIVER.clocks(sensors(y=None, x__counter=None, x__timestamp=None)) == ()


def test_foreign_short_and_remote_frames_and_damaged_lines_are_counted() -> None:
    line = pipeline()
    found = line.feed(RX, rx(b"t10072710000700000000\rt100700000000000000\rr1008\rt2000\rtq\r"), 0)
    assert kinds(found) == ["damage", "damage"]
    assert (line.losses["short_frames"], line.losses["foreign_frames"], line.losses["damaged_lines"]) == (1, 2, 2)
    assert line.feed(TX, x_frames(0, 1), 0) == []


def test_a_message_that_stops_is_reported_once_and_again_after_it_came() -> None:
    line = pipeline(quantities={}, y=None, timeout_s=0.5)
    other = frame("Status")
    line.feed(RX, x_frames(0, 1), 0)
    assert kinds(line.feed(RX, other, 500 * MS)) == []
    assert kinds(line.feed(RX, other, 501 * MS)) == ["doubt"]
    assert kinds(line.feed(RX, other, 900 * MS)) == []
    line.feed(RX, x_frames(1, 1, 500), 950 * MS)
    line.feed(RX, other, 1300 * MS)
    (event,) = [item for item in line.feed(RX, other, 1500 * MS) if isinstance(item, DeviceEvent)]
    assert "no frame of LaserX for 0.55 s" in event.text


# --- settings and files ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"dbc_text": None}, "got none"),
        ({"dbc_text": "BO_ x"}, "not a DBC file"),
        ({"dbc_text": "\0" * 1000}, "not a DBC file"),
        ({"dbc_text": " " * (layouts.MOST_TEXT + 1)}, "at most 1000000 characters"),
        ({"x": None, "y": None, "quantities": {}}, "signals to record"),
        ({"x__axis": "y"}, "x.axis: expected 'x'"),
        ({"x__message": "Laser"}, "no message 'Laser', only LaserX"),
        ({"x__message": "a b"}, "x.message"),
        ({"x__signal": "Dist"}, "no signal 'Dist', only Distance"),
        ({"x__counter": "Distance"}, "without sign"),
        ({"x__counter": None, "x__timestamp": "Count"}, "state timestamp_unit_s"),
        ({"x__timestamp": "Count", "x__timestamp_unit_s": 1e-3}, "expected at least one unit|begins again"),
        ({"x__invalid": ["Nothing"]}, "no value 'Nothing'"),
        ({"x__signal": "Count", "x__invalid": []}, "state unit_m"),
        ({"x__rate_Hz": 9000.0}, "more than the bus carries"),
        ({"quantities__temperatures__fields": {"Bad name": "Page"}}, "fields"),
        ({"quantities__temperatures__fields": {"a": "Nothing"}}, "no signal 'Nothing'"),
        ({"dbc_text": DBC.replace("(0.0001,0)", "(0,0)")}, "scale that is not 0"),
        ({"dbc_text": DBC.replace("(0.0001,0)", "(1e999,0)")}, "finite scale"),
        ({"dbc_text": DBC.replace("LaserX: 8", "LaserX: 64")}, "classic CAN, got 64"),
        ({"dbc_text": DBC.replace("0|24@1-", "0|24@1-" + "9" * 5000)}, "not a DBC file"),
        ({"dbc_text": DBC.replace("0|24@1-", "60|24@1-")}, "not a DBC file"),
    ],
)
def test_impossible_settings_are_refused(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        sensors(**changes)


@budget(deadline=None, max_examples=30)
@given(st.text(max_size=200) | st.integers(0, len(DBC)).map(lambda n: DBC[:n] + "}" + DBC[n:]))
def test_any_file_is_read_or_refused(text: str) -> None:
    with contextlib.suppress(ValueError):
        database(text)


# Both displacements in the same frames, with a counter of 16 bits, in floats.
_ONE_MESSAGE = replace(
    DRIVER,
    example={
        "dbc_text": 'VERSION ""\nBU_: N\nBO_ 17 Pair: 8 N\n SG_ X : 0|16@1- (1,0) [0|0] "um" N\n'
        ' SG_ Y : 16|24@1- (0.1,0) [0|0] "um" N\n SG_ Count : 40|12@1+ (1,0) [0|0] "" N\n',
        "x": {"message": "Pair", "signal": "X", "counter": "Count", "rate_Hz": 4000.0},
        "y": {"message": "Pair", "signal": "Y", "counter": "Count", "rate_Hz": 4000.0, "lever_ratio": 0.5},
    },
)


# A timestamp alone, multiplexed.
_NO_COUNTER = replace(
    DRIVER,
    example={
        "dbc_text": 'VERSION ""\nBU_: N\nBO_ 17 M: 8 N\n SG_ Page M : 0|8@1+ (1,0) [0|0] "" N\n'
        ' SG_ X m3 : 8|24@1- (1E-07,0) [0|0] "m" N\n SG_ T m3 : 32|32@1+ (10,0) [0|0] "us" N\n',
        "x": {"message": "M", "signal": "X", "timestamp": "T", "rate_Hz": 1000.0},
    },
)


_SLOW = {"mutations", "memory", "split", "counter wrap"}


_OTHERS = (_ONE_MESSAGE, _NO_COUNTER)


@pytest.mark.parametrize("case", kit_cases(_OTHERS, without=[(kind, name) for kind in _OTHERS for name in _SLOW]))
def test_other_descriptions_pass_the_tests_of_drivers(case: rig_testing.ContractCase) -> None:
    case()


@pytest.mark.parametrize(
    ("fault", "kind", "loss"),
    [
        ("dropped", "gap", "samples"),
        ("silent", "doubt", ""),
        ("blocked", "", "invalid"),
        ("short", "damage", "short_frames"),
        ("foreign", "", "foreign_frames"),
    ],
)
def test_every_fault_of_the_simulated_sensors_is_seen(fault: str, kind: str, loss: str) -> None:
    bench = DriverBench(DRIVER)
    bench.begin()
    bench.clock.wait(0.5)
    assert kinds(bench.items) == []
    bench.far.fail(fault, DRIVER.far_end("d", sensors(), bench.world).fault_kinds[fault].value)
    bench.clock.wait(1.5)
    assert kind == "" or kind in kinds(bench.items)
    assert loss == "" or bench.pipeline.losses[loss] > 0
    if fault == "dropped":
        assert bench.pipeline.losses["samples"] == 100


# --- a session ---------------------------------------------------------------------------------------------------


def rig_file(folder: Path) -> Path:
    """The shipped simulated rig with both lasers on one bus."""
    text = (resources.files("rig_configs") / "virtual.toml").read_text()
    bus = (
        '[devices.lasers]\ndriver = "dbc"\nport = "p"\nbitrate = 1000000\ndbc = "lasers.dbc"\n'
        '[devices.lasers.x]\nmessage = "LaserX"\nsignal = "Distance"\ncounter = "Count"\ntimestamp = "Time"\n'
        'rate_Hz = 1000\ninvalid = ["NoTarget"]\n'
        '[devices.lasers.y]\nmessage = "LaserY"\nsignal = "Distance"\ncounter = "Count"\nrate_Hz = 1000\n'
        'middle = 16000\npositive = "towards"\n'
    )
    file = folder / "rig.toml"
    file.write_text(text[: text.index("[devices.laser_x]")] + bus + text[text.index("[devices.encoder]") :])
    (folder / "lasers.dbc").write_text(DBC)
    return file


def test_a_log_is_decoded_again_with_its_own_file(tmp_path: Path) -> None:
    """The DBC file has changed in the meantime, and then it is gone."""
    file = rig_file(tmp_path)
    sim = LockstepRig(load_rig(file, settings=["virtual.seed=4"]))
    session = Session(load_rig(file, settings=["virtual.seed=4", *sim.port_settings()]), sim.clock, edge=sim.edge)
    with session:
        session.start_recording(tmp_path / "a.mcap", {"test": "record"})
        sim.clock.wait(1.5)
        session.stop_recording({})
        losses = session.recording.losses()["lasers"]
    (tmp_path / "lasers.dbc").write_text(DBC.replace("(0.0001,0)", "(0.5,0)"))
    for _ in range(2):
        assert [row.topic for row in check(tmp_path / "a.mcap") if row.difference] == []
        (tmp_path / "lasers.dbc").unlink(missing_ok=True)
    with open_log(tmp_path / "a.mcap") as log:
        for topic in ("laser/x", "laser/y"):
            assert len(log[topic]) == pytest.approx(1500, abs=40)
            assert np.std(log[topic]["displacement_m"]) < 2e-5
    assert {kind: count for kind, count in losses.items() if count} == {}


def test_a_rig_file_without_its_dbc_file_is_refused(tmp_path: Path) -> None:
    file = rig_file(tmp_path)
    both = file.read_text().replace('dbc = "lasers.dbc"', 'dbc = "lasers.dbc"\ndbc_text = "x"')
    (tmp_path / "lasers.dbc").unlink()
    with pytest.raises(RigFileError, match=r"devices\.lasers\.dbc: 'lasers\.dbc' cannot be read"):
        load_rig(file)
    (tmp_path / "lasers.dbc").mkdir()
    with pytest.raises(RigFileError, match="it is a directory"):
        load_rig(file)
    file.write_text(both)
    with pytest.raises(RigFileError, match="got both"):
        load_rig(file)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252", "utf-16"])
def test_a_dbc_file_has_the_encoding_of_the_program_that_wrote_it(tmp_path: Path, encoding: str) -> None:
    """The usual editor of DBC files writes the code page of Windows."""
    file = rig_file(tmp_path)
    text = DBC.replace('"um"', '"µm"').replace("degC", "°C").replace("\n", "\r\n")
    (tmp_path / "lasers.dbc").write_bytes(text.encode(encoding))
    lasers = load_rig(file).devices["lasers"]
    assert isinstance(lasers, CanSensors)
    signals = lasers.message("LaserY").signals
    assert lasers.y is not None
    assert lasers.unit_m(lasers.y, signals["Distance"]) == 1e-6


def test_a_file_that_is_no_text_is_refused(tmp_path: Path) -> None:
    file = rig_file(tmp_path)
    (tmp_path / "lasers.dbc").write_bytes(b"\x81\x8d\xff\x00" * 10)
    with pytest.raises(RigFileError, match="cannot be read as a text file"):
        load_rig(file)


def test_a_calibration_corrects_one_of_two_sensors(tmp_path: Path) -> None:
    rig = load_rig(rig_file(tmp_path))
    corrections = tmp_path / "calibration.toml"
    corrections.write_text("[devices.lasers.y]\nlever_ratio = 1.01\n")
    corrected = Calibration.load(corrections).correct(rig)
    assert [d.lever_ratio for d in corrected.roles.displacements] == [1.0, 1.01]
    assert corrected.roles.duties == {"lasers": "x; y"}
    corrections.write_text("[devices.lasers.y]\nrate_Hz = 7\n")
    with pytest.raises(RigFileError, match=r"devices\.lasers\.y\.rate_Hz: expected a calibration"):
        Calibration.load(corrections).correct(rig)


START_NS = 1_700_000_000_000_000_000
SEED = {"device_ns": 1_000 * MS, "host_ns": START_NS, "rate": 0.0, "wrap_ns": 2**32 * 1000}
NO_LOSSES = dict.fromkeys(
    ("samples", "damaged_lines", "refused_lines", "short_frames", "doubtful_frames", "invalid", "foreign_frames"), 0
)


def pipeline_without(*without: str, identity: dict[str, Any] | None = None, **changes: Any) -> CanPipeline:
    """The example's pipeline without some of its tables."""
    table: dict[str, Any] = {"driver": "dbc", "port": "p", **copy.deepcopy(SETTINGS), **changes}
    settings = CanSensors.model_validate({key: value for key, value in table.items() if key not in without})
    found = DRIVER.pipeline("bus", settings, identity or {})
    assert isinstance(found, CanPipeline)
    return found


def joined(*without: str, **changes: Any) -> CanPipeline:
    return pipeline_without(*without, **changes)


def laser_x(count: int, micrometres: int = 100, time_us: int = 0, size: int = 8) -> bytes:
    """A frame of LaserX: 24 bits of 0.1 µm, a counter of 8 bits, a time of 32 bits, little-endian."""
    data = (10 * micrometres).to_bytes(3, "little") + bytes([count]) + time_us.to_bytes(4, "little")
    return encode(CanFrame(0x100, data[:size]))


def laser_y(count: int, size: int = 6) -> bytes:
    """A frame of LaserY: 16 bits of 0.5 µm, a counter of 12 bits, big-endian."""
    data = (32_000).to_bytes(2, "big") + (count << 4).to_bytes(2, "big") + bytes(4)
    return encode(CanFrame(0x200, data[:size], extended=True))


def counters(items: Items, topic: str) -> list[int]:
    found = [item for item in items if isinstance(item, Batch) and item.channel.topic == topic]
    return [number for batch in found for number in batch.sequence.tolist()]


def events(items: Items) -> list[tuple[str, str, dict[str, Any]]]:
    return [(item.kind, item.text, dict(item.facts)) for item in items if isinstance(item, DeviceEvent)]


def test_only_data_frames_with_the_identifier_of_a_message_are_its_own() -> None:
    """An identifier of 11 bits and one of 29 bits with the same number are different ones."""
    data = bytes.fromhex("0000000000000000")
    foreign = [
        *(CanFrame(number, data) for number in (0x0FF, 0x101, 0x200, 0x2FF, 0x301, 0x7FF)),
        *(CanFrame(number, data, extended=True) for number in (0x100, 0x1FF, 0x201, 0x300)),
        CanFrame(0x100, bytes(8), remote=True),
        CanFrame(0x200, bytes(6), extended=True, remote=True),
        CanFrame(0x300, bytes(4), remote=True),
    ]
    status = encode(CanFrame(0x300, bytes(4)))
    for own_first in (True, False):
        line = joined()
        own, others = laser_x(5) + laser_y(6) + status, b"".join(map(encode, foreign))
        found = line.feed(RX, own + others if own_first else others + own, MS)
        assert (counters(found, "laser/x"), counters(found, "laser/y")) == ([5], [6])
        assert counters(found, "can/temperatures") == [0]
        assert events(found) == []
        assert line.losses == NO_LOSSES | {"foreign_frames": len(foreign)}
        assert line.feed(RX, encode(foreign[0]), 2 * MS) == []
        assert line.losses["foreign_frames"] == len(foreign) + 1


def test_a_frame_may_be_longer_than_its_message_and_not_shorter() -> None:
    line = joined()
    found = line.feed(RX, laser_x(1, size=7) + laser_x(2, time_us=1000) + laser_x(3, size=3), MS)
    text = "2 frames of LaserX are shorter than the 8 bytes of the DBC file"
    assert events(found) == [("damage", text, {"frames": 2})]
    assert counters(found, "laser/x") == [2]
    found = line.feed(RX, laser_y(1) + laser_y(2, size=8) + laser_y(3, size=7), 2 * MS)
    assert (counters(found, "laser/y"), events(found)) == ([1, 2, 3], [])
    found = line.feed(RX, laser_y(4, size=5) + laser_y(5, size=5), 3 * MS)
    assert [type(item) for item in found] == [DeviceEvent]
    assert line.losses == NO_LOSSES | {"short_frames": 4}


def test_the_frames_of_a_displacement_have_the_length_of_its_own_message() -> None:
    """Two messages of a file may have the same identifier: a number behind the end of a frame would be 0."""
    other = 'BO_ 256 Other: 2 Laser\n SG_ Level : 0|8@1+ (1,0) [0|0] "" Host\n\nVAL_ 256'
    quantities = {"level": {"message": "Other", "fields": {"level": "Level"}}}
    line = joined("y", dbc_text=DBC.replace("VAL_ 256", other), quantities=quantities)
    found = line.feed(RX, laser_x(1, size=2) + laser_x(2), MS)
    assert [kind for kind, *_ in events(found)] == ["damage"]
    assert (counters(found, "laser/x"), line.losses["short_frames"]) == ([2], 1)


def test_a_silence_is_reported_by_the_next_frame_from_the_bus() -> None:
    """An empty read, the host's own bytes and the adapter's answers are not from the bus."""
    line = joined(timeout_s=0.5)
    line.feed(RX, laser_x(1) + laser_y(1), MS)
    assert line.feed(RX, b"", 900 * MS) == []
    assert line.feed(TX, laser_x(2), 900 * MS) == []
    assert line.feed(RX, adapter_message(AdapterMessage.OPENED), 900 * MS) == []
    foreign = encode(CanFrame(0x7E5, b"\x01"))
    assert line.feed(RX, foreign, 400 * MS) == []
    assert [kind for kind, *_ in events(line.feed(RX, foreign, 900 * MS))] == ["doubt", "doubt"]


@pytest.mark.parametrize(("without", "seeded"), [(("y",), True), ((), False)])
def test_the_clock_of_a_bus_with_one_continues_from_an_earlier_log(without: tuple[str, ...], seeded: bool) -> None:
    """The sensor's time is 1 s after the seed's, the read 3 ms late. Without a seed the first read has no delay."""
    line = joined(*without, identity={"clock_seed": SEED})
    found = line.feed(RX, laser_x(1, time_us=2_000_000), START_NS + 1_003 * MS)
    (batch,) = (item for item in found if isinstance(item, Batch))
    assert batch.time_ns.tolist() == [START_NS + (1_000 if seeded else 1_003) * MS]
    seed = line.status.clock_seed
    assert (seed is not None) == seeded
    assert seed is None or (seed.device_ns, seed.wrap_ns) == (2_000 * MS, 2**32 * 1000)


def test_a_bus_without_displacements_has_no_clock_and_uses_no_seed() -> None:
    line = joined("x", "y", identity={"clock_seed": "damaged"})
    assert line.status.clock_seed is None
    assert counters(line.feed(RX, encode(CanFrame(0x300, bytes(4))), MS), "can/temperatures") == [0]
