"""Sessions that only receive: no byte is sent, and the log contains every received byte from the first to the last."""

from __future__ import annotations

import sys
from contextlib import contextmanager

import pytest

from daq.acquisition.life import LISTENING, Policy
from daq.acquisition.session import Session
from daq.drivers.devices import make_pipelines
from daq.errors import LinkLost
from daq.log import open_log
from daq.replay import check
from daq.transports import HostClock
from daq.transports.wires import make_wire
from rig_configs import load_rig
from tests.daq.small_log import device_bytes

KINDS = ["tcp"] if sys.platform == "win32" else ["pty", "tcp"]
DEVICES = ("laser_x", "laser_y", "encoder", "drive")


@contextmanager
def cables(kind):
    """A cable per device, the drive's behind an adapter, and a rig file that names their ports."""
    wires = {name: make_wire(kind, adapter=name == "drive") for name in DEVICES}
    try:
        yield wires, load_rig("virtual", settings={f"devices.{name}.port": wire.port for name, wire in wires.items()})
    finally:
        for wire in wires.values():
            wire.close()


@contextmanager
def listening(kind, tmp_path, identities=None):
    """A session that only receives and records, with its wires, of which a TCP wire has accepted its host."""
    with cables(kind) as (wires, rig):
        session = Session(rig, HostClock(), identities, policy=LISTENING)
        with session.listen(tmp_path / "heard.mcap", {"test": "record"}):
            for wire in wires.values():
                wire.descriptor()
            yield wires, session


def _arrived(session, wires):
    """Bytes that arrived, with what a pty did not take at once sent after."""
    for wire in wires.values():
        wire.send(b"")
    return session.devices.bytes_in


@pytest.mark.parametrize("kind", KINDS)
def test_every_byte_from_the_first_to_the_last(tmp_path, kind):
    with listening(kind, tmp_path) as (wires, session):
        sent = dict.fromkeys(wires, b"")
        for device, data in device_bytes(20):
            wires[device].send(data)
            sent[device] += data
        total = sum(map(len, sent.values()))
        session.wait_for(lambda: _arrived(session, wires) == total, 10, "every byte")
        for wire in wires.values():
            assert wire.receive() == b""  # nothing was ever sent
            wire.close()
        with pytest.raises(LinkLost):
            session.wait_for(lambda: False, 10, "the cables to be missed")
        path = session.stop_recording({"ended": "cable"})
    with open_log(path) as log:
        assert log.complete
        assert {device: b"".join(chunk.data for chunk in log.raw(device)) for device in sent} == sent
        assert log.count("laser/x") == log.count("laser/y") == 20 * 40
        assert log.count("pendulums") == 20 * 10
        assert log.count("motor") == 20
    assert [row for row in check(path) if row.difference] == []


def test_the_last_bytes_before_a_cable_is_pulled_are_kept(tmp_path):
    """They may lie in the reader's hand, waiting for the next arrival, when the link is lost."""
    reads = [data for device, data in device_bytes(6) if device == "laser_x"]
    with listening("tcp", tmp_path) as (wires, session):
        wires["laser_x"].send(reads[0])
        session.wait_for(lambda: session.devices.bytes_in == len(reads[0]), 10, "the first bytes")
        for data in reads[1:]:  # while the reader rests
            wires["laser_x"].send(data)
        wires["laser_x"].close()
        session.wait_for(lambda: bool(session.notices), 10, "the cable to be missed")
        path = session.stop_recording({"ended": "cable"})
    with open_log(path) as log:
        assert b"".join(chunk.data for chunk in log.raw("laser_x")) == b"".join(reads)


def test_a_laser_whose_words_are_stored_is_decoded_by_them(tmp_path):
    identities = {"laser_x": {"words": ["DIST", "COUNTER", "TIMESTAMP_LO", "TIMESTAMP_HI"], "range_m": 0.05}}
    data = device_bytes(1)[0][1]
    with listening("tcp", tmp_path, identities) as (wires, session):
        pipeline = make_pipelines(session.rig.devices, identities)["laser_x"]
        wires["laser_x"].send(data)
        session.wait_for(lambda: session.devices.bytes_in == len(data), 10, "the bytes")
        path = session.stop_recording({})
    with open_log(path) as log:
        expected = pipeline.feed(0, data, 10**18)[0].columns["displacement_m"]
        assert log["laser/x"].displacement_m.tolist() == expected.tolist()


def test_devices_from_which_no_byte_was_received_are_named(tmp_path):
    """A device that answers only on request sends nothing to a session that only receives."""
    with listening("tcp", tmp_path) as (wires, session):
        wires["encoder"].send(b"x")
        session.wait_for(lambda: _arrived(session, wires) == 1, 10, "the byte")
        assert session.devices.unheard == ["laser_x", "laser_y", "drive"]


def test_a_lenient_session_that_only_receives_reports_a_port_that_cannot_be_opened(tmp_path):
    with cables("tcp") as (wires, rig):
        wires["drive"].close()
        session = Session(rig, HostClock(), policy=Policy(commands=False, lenient=True))
        with session.listen(tmp_path / "heard.mcap", {"test": "record"}):
            assert set(session.devices.unopened) == {"drive"}
