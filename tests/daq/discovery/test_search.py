"""The search for the device on a port: by its bytes alone, by requests, and what it leaves as it was."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings as hypothesis_settings, strategies as st

from daq.discovery import search as search_module
from daq.discovery.opening import PortNotOpened
from daq.discovery.search import PortSearch, Result
from daq.discovery.trials import Evidence, Trial, drivers_found, evidence_of, trials_of, usual_rate
from daq.drivers.contract import DeviceLine
from daq.drivers.driver import Driver
from daq.drivers.simulated import FarEnd
from daq.errors import LinkLost
from daq.transports.can_frames import CanFrame, encode, open_bus
from daq.transports.slcan import encode as text_of
from rig_drivers.riftek import wire as riftek
from tests.daq.far_end_on_port import PORT, Cable, CableLink, SilentDevice, Source
from tests.effort import cases, thorough

DRIVERS, FAILED = drivers_found()
ASKING = [each for each in DRIVERS if each.identity_request is not None]


def search(cable: Cable, ask: bool = False, drivers: list[Driver] = DRIVERS) -> Result:
    return PortSearch(cable.port, drivers, cable.clock, lambda text, share: None, cable.connect).run(ask)


def seen(result: Result) -> Evidence:
    assert result.evidence is not None
    return result.evidence


def streaming_optoncdt(**settings: Any) -> Cable:
    cable = Cable.of("optoncdt", **settings)
    rate = f"MEASRATE {settings.get('rate_Hz', 4000) / 1000:g}\n".encode()
    cable.far.receive(b"OUTADD_RS422 COUNTER TIMESTAMP\n" + rate + b"OUTPUT RS422\n", 0.0)
    return cable


def streaming_riftek(**settings: Any) -> Cable:
    cable = Cable.of("riftek", **settings)
    period = round(1e6 / settings.get("rate_Hz", 4000))
    for number, value in ((riftek.PERIOD + 1, period >> 8), (riftek.PERIOD, period & 0xFF)):
        cable.far.receive(riftek.request(1, riftek.WRITE, bytes([number, value])), 0.0)
    cable.far.receive(riftek.request(1, riftek.START), 0.0)
    return cable


# --- by receiving ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "name", "expected"),
    [
        (streaming_optoncdt, "optoncdt", {"baud": 921_600, "rate_Hz": 4000.0}),
        pytest.param(
            lambda: streaming_optoncdt(baud=230_400, rate_Hz=1000.0),
            "optoncdt",
            {"baud": 230_400, "rate_Hz": 1000.0},
            marks=thorough,
        ),
        pytest.param(streaming_riftek, "riftek", {"baud": 921_600, "parity": "E", "rate_Hz": 4000.0}, marks=thorough),
        (lambda: streaming_riftek(baud=9600, rate_Hz=200.0), "riftek", {"baud": 9600, "rate_Hz": 200.0}),
        pytest.param(
            lambda: streaming_riftek(rate_Hz=500.0), "riftek", {"baud": 921_600, "rate_Hz": 500.0}, marks=thorough
        ),
        (
            lambda: Cable.of("rotorlink", baud=230_400, rate_Hz=500),
            "rotorlink",
            {"baud": 230_400, "rate_Hz": 500, "node": 1, "counts_per_revolution": 4096},
        ),
        (
            lambda: Cable.of("xbee", api_mode=1, baud=57_600, node_address="0013A20040522BBB"),
            "xbee",
            {"baud": 57_600, "api_mode": 1, "node_address": "0013A20040522BBB", "rate_Hz": 250.0},
        ),
        (
            lambda: Cable.of("optoncdt_ethernet", port="socket://10.0.0.3:1024", serial=77),
            "optoncdt_ethernet",
            {"serial": 77, "rate_Hz": 5000.0},
        ),
    ],
    ids=lambda value: value if isinstance(value, str) else None,
)
def test_a_device_that_sends_is_recognised_without_a_sent_byte(
    make: Callable[[], Cable], name: str, expected: dict[str, Any]
) -> None:
    cable = make()
    result = search(cable)
    assert result.state == "device"
    assert seen(result).trial.driver.name == name
    assert result.how == "received"
    assert {key: seen(result).settings.get(key) for key in expected} == expected
    assert seen(result).losses == 0
    assert seen(result).samples > 100
    assert cable.written == []
    assert result.others == ()


def test_a_drive_on_an_open_bus_is_recognised_by_its_reports() -> None:
    cable = Cable.of("cia402", node_id=9)
    start = encode(CanFrame(0, bytes([1, 9])))
    cable.far.receive(open_bus(500_000) + start, 0.0)
    result = search(cable)
    assert seen(result).trial.driver.name == "cia402"
    assert seen(result).settings["node_id"] == 9
    assert cable.written == []


def test_a_sensor_without_a_target_is_recognised_too() -> None:
    cable = streaming_optoncdt()
    cable.far.fail("blocked", 1)
    result = search(cable)
    assert (result.state, seen(result).losses) == ("device", 0)


def test_a_silent_port_takes_one_look() -> None:
    cable = Cable(lambda world: SilentDevice())
    result = search(cable)
    assert result.state == "silent"
    assert len(cable.lines) == 1
    assert result.seconds < 1.3


def test_a_device_that_reports_each_second_is_not_silent() -> None:
    due = iter([b""] * 50 + [b"x"] + [b""] * 5000)
    assert search(Cable(lambda world: Source(lambda: next(due)))).state == "unknown device"


@pytest.mark.parametrize(
    "make",
    [
        lambda rng: rng.bytes(80),
        lambda rng: b"$GPGGA,123519,4807.038,N,01131.000,E\r\n",
        lambda rng: bytes(40),
        lambda rng: b"\xff" * 40,
        lambda rng: b"U" * 50,
        lambda rng: bytes(rng.integers(0x80, 0x100, 64, np.uint8)),
        lambda rng: b"t1814" + b"%08X\r" % int(rng.integers(2**32)),
    ],
    ids=["random", "text", "zeros", "ones", "one letter", "high bytes", "another node's frames"],
)
@pytest.mark.parametrize("ask", [False, True])
def test_a_foreign_device_gets_no_driver(make: Callable[[np.random.Generator], bytes], ask: bool) -> None:
    rng = np.random.default_rng(1)
    result = search(Cable(lambda world: Source(lambda: make(rng))), ask)
    assert result.state == "unknown device"
    assert result.evidence is None
    assert result.bytes_in > 1000
    assert result.seconds < 17


@given(st.lists(st.binary(max_size=300), max_size=8))
@hypothesis_settings(max_examples=cases(15, 40))
def test_bytes_of_any_kind_convince_no_driver_and_raise_nothing(parts: list[bytes]) -> None:
    reads = [(part, 1_700_000_000_000_000_000 + i * 20_000_000) for i, part in enumerate(parts)]
    for trial in trials_of(DRIVERS, PORT, True):
        found = evidence_of(trial, reads)
        assert found is None or not found.convinces


def test_reading_ends_on_a_line_that_never_pauses(monkeypatch: pytest.MonkeyPatch) -> None:
    most = cases(50_000, search_module._MOST_BYTES)
    monkeypatch.setattr(search_module, "_MOST_BYTES", most)
    cable = Cable(lambda world: Source(lambda: bytes(most // 5)))
    assert search(cable).state == "unknown device"
    assert cable.clock.now < 3


# --- by asking -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "settings", "expected"),
    [
        ("optoncdt", {"baud": 115_200}, {"baud": 115_200, "range_m": 0.025, "rate_Hz": 4000.0}),
        ("optoncdt", {"range_m": 0.01}, {"baud": 921_600, "range_m": 0.01}),
        ("riftek", {"baud": 9600, "rate_Hz": 200.0}, {"baud": 9600, "range_m": 0.025, "rate_Hz": 200.0}),
        ("xbee", {"baud": 9600, "rate_Hz": 100, "api_mode": 1}, {"api_mode": 1, "baud": 9600}),
        ("xbee", {"api_mode": 2}, {"api_mode": 2, "baud": 115_200}),
        ("vesc", {}, {"baud": 115_200}),
        ("cia402", {}, {"node_id": 5, "bitrate": 500_000}),
        ("cia402", {"node_id": 127}, {"node_id": 127}),
        ("cia406", {}, {"a_node": 3, "b_node": 4, "shaft_node": 5, "counts_per_revolution": 4096}),
        ("cia406", {"a_node": 90, "b_node": 17, "shaft_node": None}, {"a_node": 17, "b_node": 90, "shaft_node": None}),
        ("microstrain", {}, {"aspp": 3, "baud": 921_600, "node_address": None}),
        ("microstrain", {"aspp": 1, "baud": 115_200}, {"aspp": 1, "baud": 115_200}),
        ("polled_laser", {"dialect": "LK-G"}, {"dialect": "LK-G", "output": 1, "baud": 115_200}),
        ("polled_laser", {"dialect": "LK-G5000"}, {"dialect": "LK-G5000"}),
        ("polled_laser", {"dialect": "IL", "baud": 9600, "rate_Hz": 20}, {"dialect": "IL", "baud": 9600}),
        ("polled_laser", {"dialect": "HL-G1"}, {"dialect": "HL-G1"}),
    ],
    ids=str,
)
def test_a_device_that_answers_is_identified(name: str, settings: dict[str, Any], expected: dict[str, Any]) -> None:
    cable = Cable.of(name, **settings)
    result = search(cable, ask=True)
    assert seen(result).trial.driver.name == name
    assert {key: seen(result).settings.get(key) for key in expected} == expected
    assert result.seconds < 8


def test_serial_number_and_firmware_are_reported() -> None:
    assert seen(search(Cable.of("optoncdt"), ask=True)).found.identity == {
        "name": "ILD1420",
        "serial": "14200001",
        "version": "001.019",
    }
    assert seen(search(Cable.of("riftek", baud=9600, rate_Hz=200.0), ask=True)).found.identity["serial"] == 19001
    assert seen(search(Cable.of("vesc"), ask=True)).found.identity["hardware"] == "60_MK5"
    drive = seen(search(Cable.of("cia402"), ask=True)).found.identity
    assert drive == {"vendor_id": "0xa11", "serial": 24601}
    encoders = seen(search(Cable.of("cia406"), ask=True)).found.identity
    assert list(encoders) == ["node_3", "node_4", "node_5"]
    assert all(str(each).startswith("serial ") for each in encoders.values())
    module = seen(search(Cable.of("xbee"), ask=True)).found.identity
    own = {"module_firmware": "100A", "module_hardware": "2E48", "module_serial": "0013A20040522BAA"}
    assert module == {"node": 1, "firmware": "1.4", "battery_mV": 3712, **own}


@pytest.mark.parametrize("make", [streaming_optoncdt, streaming_riftek])
def test_a_streaming_sensor_answers_and_goes_on_streaming(make: Callable[[], Cable]) -> None:
    cable = make()
    result = search(cable, ask=True)
    assert result.how == "received"
    assert seen(result).samples > 1000
    assert seen(result).settings["range_m"] == 0.025
    assert "serial" in seen(result).found.identity
    assert len(cable.advance(0.1)) > 1000


def test_a_stream_of_distances_alone_is_found_by_asking() -> None:
    cable = Cable.of("optoncdt")
    cable.far.receive(b"OUTPUT RS422\n", 0.0)
    assert search(cable).state == "unknown device"
    result = search(cable, ask=True)
    assert result.state == "device"
    assert seen(result).settings["range_m"] == 0.025


def test_the_bit_rate_of_a_bus_is_that_at_which_frames_arrive() -> None:
    """An adapter in listen-only mode gives frames at the bus's rate only."""

    class Bus(FarEnd):
        def __init__(self) -> None:
            self.rate, self.heard = "", list[bytes]()

        def receive(self, data: bytes, now_s: float) -> bytes:
            self.heard.append(data)
            out = b""
            for line in data.split(b"\r")[:-1]:
                self.rate = line.decode() if line[:1] == b"S" else self.rate
                out += b"V1013\r" if line == b"V" else b"\r"
                out += b"t70517F\r" if line == b"L" and self.rate == "S5" else b""
                if line.startswith(b"t605") and self.rate == "S5":
                    sub = bytes.fromhex(line[5:].decode())[1:4]
                    out += text_of(CanFrame(0x585, b"\x43" + sub + b"\x92\x01\x02\x00"))
            return out

    cable = Cable(lambda world: Bus())
    result = search(cable, ask=True)
    assert seen(result).settings == {"node_id": 5, "bitrate": 250_000}
    sent = b"".join(cable.written)
    assert sent.count(b"O\r") == 1, "the bus is opened once, at the rate that was found"
    assert sent.index(b"S5\rO\r") > sent.index(b"S5\rL\r")
    assert sent.endswith(b"C\r"), "and closed at the end"


class Canable(FarEnd):
    """An adapter with the firmware of CANable: no acknowledgement, M1 in place of L. A drive on a bus of 250 kbit/s."""

    def __init__(self) -> None:
        self.rate, self.open, self.silent, self.loud = "", False, False, list[str]()

    def receive(self, data: bytes, now_s: float) -> bytes:
        out = b""
        for line in data.decode().split("\r")[:-1]:
            if line[:1] in {"S", "M"}:
                self.rate, self.silent = (line, self.silent) if line[0] == "S" else (self.rate, line == "M1")
            elif line in {"O", "C"}:
                self.open = line == "O"
                self.loud += [self.rate] * (self.open and not self.silent)
                out += b"t70517F\r" * (self.open and self.rate == "S5")
            elif line == "V":
                out += b"b158aa7 github.com/normaldotcom/canable-fw.git\r"
            elif line.startswith("t605") and self.open and not self.silent and self.rate == "S5":
                sub = bytes.fromhex(line[5:])[1:4]
                out += text_of(CanFrame(0x585, b"\x43" + sub + b"\x92\x01\x02\x00"))
        return out


def test_an_adapter_without_acknowledgements_and_without_l_is_used_too() -> None:
    adapter = Canable()
    result = search(Cable(lambda world: adapter), ask=True)
    assert seen(result).settings == {"node_id": 5, "bitrate": 250_000}
    assert adapter.loud == ["S5"], "it takes part on the bus at the bus's rate only"
    assert (adapter.open, adapter.silent) == (False, False)


@pytest.mark.parametrize("name", ["cia402", "cia406"])
def test_a_bus_that_was_open_stays_open(name: str) -> None:
    """Another program has left it open. Nothing that was found there, and no device without an adapter, is closed."""
    cable = Cable(lambda world: Source(lambda: b"t70117F\r"))
    search(cable, True, [each for each in ASKING if each.name == name])
    silent = Cable(lambda world: SilentDevice())
    search(silent, True, [each for each in ASKING if each.name == name])
    assert b"V\r" in b"".join(cable.written)
    assert b"C\r" not in b"".join(cable.written + silent.written)


def far_ends() -> list[tuple[str, dict[str, Any]]]:
    polled = [("polled_laser", {"dialect": dialect}) for dialect in ("LK-G", "LK-G5000", "IL", "HL-G1")]
    return [(each.name, {}) for each in DRIVERS if each.name != "polled_laser"] + [
        (name, {**settings, "rate_Hz": 20}) for name, settings in polled
    ]


def state_of(far: FarEnd) -> dict[str, Any]:
    """What a device would keep of a command, without its clocks, noise and request buffers."""
    kept = ("parameters", "_stored", "streaming", "state", "_objects", "_target_rpm", "emergencies", "_command")
    found = {key: copy.deepcopy(value) for key, value in vars(far).items() if key in kept}
    if far.facts().get("watchdog_ms"):
        found.pop("emergencies", None)  # it reports that its host is silent again
    commands = vars(far).get("_commands")
    if commands is not None:
        found |= {key: getattr(commands, key) for key in ("streaming", "rate_Hz", "outputs")}
    nmt = vars(far).get("_nmt")
    return found if nmt is None else {**found, "network": nmt.state}


@pytest.mark.parametrize(("name", "settings"), far_ends(), ids=str)
def test_no_request_of_any_driver_changes_any_device(name: str, settings: dict[str, Any]) -> None:
    """Each driver is searched alone, so that every request is sent to every device."""
    for each in ASKING:
        cable = Cable.of(name, **settings)
        cable.advance(0.02)
        before, watched = state_of(cable.far), cable.far.facts().get("watchdog_ms")
        search(cable, True, [each])
        assert state_of(cable.far) == before
        assert cable.motion.target_rad_s == 0.0
        if each.name != name:
            assert cable.written
        assert cable.far.facts().get("watchdog_ms") == watched


def test_a_request_to_a_lost_device_ends_the_search(monkeypatch: pytest.MonkeyPatch) -> None:
    def lost(self: CableLink, data: bytes) -> None:
        raise LinkLost("unplugged")

    monkeypatch.setattr(CableLink, "write", lost)
    result = search(Cable(lambda world: SilentDevice()), ask=True)
    assert (result.state, result.note) == ("not opened", "unplugged")


def test_a_port_that_cannot_be_opened_is_reported() -> None:
    def refused(line: DeviceLine) -> CableLink:
        raise PortNotOpened("in use", "open in another program")

    cable = Cable(lambda world: SilentDevice())
    result = PortSearch(PORT, DRIVERS, cable.clock, lambda text, share: None, refused).run(ask=True)
    assert (result.state, result.note, result.evidence) == ("in use", "open in another program", None)


def test_the_progress_never_exceeds_the_whole() -> None:
    shares: list[float] = []
    cable = Cable(lambda world: Source(lambda: b"x"))
    PortSearch(PORT, DRIVERS, cable.clock, lambda text, share: shares.append(share), cable.connect).run(ask=True)
    assert shares == sorted(shares)
    assert 0 <= shares[0] < shares[-1] < 1


# --- trials --------------------------------------------------------------------------------------------------------


def test_every_installed_driver_is_tried_and_its_settings_are_valid() -> None:
    assert FAILED == []
    on_any = {each.driver.name for each in trials_of(DRIVERS, "socket://h:1", False)}
    assert on_any == {each.name for each in DRIVERS if not each.settings.files}  # a file describes the others


ON_A_BUS = {"cia402", "cia406", "odrive", "vesc_can"}


def test_a_serial_port_is_not_opened_without_a_rate_and_a_bus_only_for_its_devices() -> None:
    assert all(each.line.baud > 0 for each in trials_of(DRIVERS, PORT, True))
    assert {each.driver.name for each in trials_of(DRIVERS, "can:socketcan:can0", False)} == ON_A_BUS


def test_without_a_line_rate_settings_of_the_line_are_not_repeated() -> None:
    trials = trials_of(DRIVERS, "/dev/pts/9", False)
    keys = [(t.driver.name, repr(t.settings.model_dump(exclude={"baud", "parity", "rate_Hz"}))) for t in trials]
    assert len(set(keys)) == len(keys)


@pytest.mark.parametrize(
    ("measured", "usual"),
    [(3978.0, 4000.0), (1012.0, 1000.0), (312.0, 312.5), (99.2, 100.0), (9800.0, 10_000.0), (700.0, 700.0)],
)
def test_a_measured_rate_is_rounded_to_a_usual_one(measured: float, usual: float) -> None:
    assert usual_rate(measured) == pytest.approx(usual)


@pytest.mark.parametrize("measured", [float("nan"), 0.0, -3.0, float("inf")])
def test_without_a_rate_there_is_no_usual_one(measured: float) -> None:
    assert usual_rate(measured) is None


def test_settings_that_are_refused_leave_the_trial_as_it_was() -> None:
    trial = trials_of([each for each in DRIVERS if each.name == "riftek"], PORT, True)[0]
    assert trial.with_settings({"rate_Hz": 300.0}) == trial
    assert trial.with_settings({"rate_Hz": 500.0}).settings.model_dump()["rate_Hz"] == 500.0
    assert isinstance(trial, Trial)


def test_recognising_drivers_take_bytes_of_any_device() -> None:
    rng = np.random.default_rng(2)
    for each in DRIVERS:
        if each.recognise is not None:
            for trial in trials_of([each], "socket://h:1", False):
                assert each.recognise(trial.settings, rng.bytes(3000)) is None
                assert each.recognise(trial.settings, b"") is None
