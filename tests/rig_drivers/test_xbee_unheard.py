"""What an XBee module without samples sends, in words for the operator: senders, payloads, another mode, no request."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from daq.drivers.rotorlink import wire as rotorlink
from daq.errors import DeviceError
from daq.items import RX, TX
from daq.lockstep.clock import SimulatedClock
from rig_drivers.xbee.driver import DRIVER
from rig_drivers.xbee.stream import XBeePipeline
from tests.rig_drivers.test_xbee_stream import NODE, START_NS, STRANGER, api, block, module_frame, pipeline, settings

MS = 1_000_000
STATUS = rotorlink.NodeStatus(1, 0, 1000, 3700, 250, 8, 0, 1, 4, 4096).pack()
ANSWER = "88 01 41 50 00 02"


def heard(*frames: bytes, into: XBeePipeline | None = None) -> str:
    made = into or pipeline()
    for i, frame in enumerate(frames):
        made.feed(RX, frame, START_NS + 20 * MS * i)
    return made.status.complaint


def test_the_complaint_names_the_address_from_which_a_node_sends() -> None:
    third = "0013A20088888888"
    text = f"frames from {STRANGER} ignored: the rig file states node_address = {NODE}"
    assert heard(api(block(0), source=STRANGER), api(b"T=21.5", source=third)) == text
    assert heard(api(b"T=21.5", source=third), api(block(0), source=STRANGER)) == text
    assert third in heard(api(b"T=21.5", source=third))


def test_there_is_no_complaint_about_other_senders_once_the_node_is_received() -> None:
    stranger = api(block(0), source=STRANGER)
    assert heard(stranger, api(block(0)), stranger) == ""
    assert heard(stranger, api(STATUS), stranger) == ""


@pytest.mark.parametrize(("payload", "reason"), [(block(0)[:30], "crc"), (rotorlink.wire(block(0)), "crc")])
def test_the_complaint_explains_payloads_that_are_no_frames_of_a_node(payload: bytes, reason: str) -> None:
    text = heard(api(STATUS), api(payload))
    assert text.startswith(f"frames from {NODE} contain no whole payload of a node (payload {reason})")
    assert heard(api(payload), api(block(0)), api(payload)) == ""


def test_a_node_without_angles_needs_no_block() -> None:
    marks = settings().model_copy(update={"angles": False})
    assert heard(api(STATUS), api(b"damaged"), into=XBeePipeline("encoder", marks, {})) == ""


def transparent(seconds: float, start_ns: int) -> Iterator[tuple[bytes, int]]:
    """Payloads of a module in transparent mode."""
    return ((block(i, samples=10), start_ns + 40 * MS * i) for i in range(int(seconds * 25)))


def test_a_module_that_restarts_in_another_mode_is_recognised_until_it_answers() -> None:
    line = pipeline()
    line.feed(RX, api(block(0)), START_NS)
    for data, host_ns in transparent(1.9, START_NS + 40 * MS):
        line.feed(RX, data, host_ns)
        assert not line.status.set_up_lost
    for data, host_ns in transparent(1.0, START_NS + 2000 * MS):
        line.feed(RX, data, host_ns)
    assert "no API frame for 2 s" in line.status.set_up_lost
    line.feed(TX, module_frame("08 01 41 50"), START_NS + 3000 * MS)
    assert line.status.set_up_lost, "a request alone does not show that the module is set up"
    line.feed(RX, module_frame(ANSWER), START_NS + 3010 * MS)
    assert not line.status.set_up_lost


def test_a_silence_within_a_frame_is_no_other_mode() -> None:
    line, frame = pipeline(), api(block(0))
    for i, (data, after_ms) in enumerate([(frame, 0), (frame[:20], 0), (frame[20:40], 5000), (frame[40:], 5001)]):
        line.feed(RX, data, START_NS + (after_ms + i) * MS)
        assert not line.status.set_up_lost
    assert line.losses["damaged_frames"] == 0


def test_a_short_burst_of_noise_is_no_other_mode() -> None:
    line = pipeline()
    line.feed(RX, bytes(5000), START_NS)
    line.feed(RX, bytes(5000), START_NS + 1999 * MS)
    assert not line.status.set_up_lost
    line.feed(RX, bytes(1), START_NS + 2001 * MS)
    assert line.status.set_up_lost


@pytest.mark.parametrize(("legacy", "advised"), [(False, True), (True, False)])
def test_a_request_without_any_status_may_be_of_a_type_that_the_module_does_not_execute(
    legacy: bool, advised: bool
) -> None:
    config = settings().model_copy(update={"legacy_transmit": legacy})
    with pytest.raises(DeviceError, match="after 20 tries") as error:
        DRIVER.locks(config, lambda data: None, SimulatedClock()).command("lock A", lambda: None)
    assert ("legacy_transmit = true" in str(error.value)) is advised
