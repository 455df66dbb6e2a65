"""The interlocks that the session evaluates (links, drive, disk, operator): each trips on a virtual rig."""

from __future__ import annotations

import json
import shutil
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from daq.acquisition.interlock_table import SESSION
from daq.acquisition.session import Session
from daq.drivers.cia402 import wire as cia402
from daq.log import open_log
from rig_cli.simulated import VirtualRigProcess
from rig_configs import load_rig
from tests.conftest import LATE_BEATS, TIME_SCALE

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="one rig for all, on ptys")

Trip = Callable[[Session, VirtualRigProcess, pytest.MonkeyPatch], None]


@pytest.fixture(scope="module")
def far_end() -> Iterator[VirtualRigProcess]:
    with VirtualRigProcess("virtual", ["virtual.seed=3"], TIME_SCALE, waits=True) as process:
        yield process


def waits_for_trouble(session: Session) -> None:
    session.wait_for(lambda: False, 8.0, "a trip")


def drops_out(session: Session, far_end: VirtualRigProcess, _: pytest.MonkeyPatch) -> None:
    session.drive.enable()
    far_end.line.ask("fail", device="drive", what="fault", value=0x3220)
    waits_for_trouble(session)


def has_an_emergency(session: Session, far_end: VirtualRigProcess, _: pytest.MonkeyPatch) -> None:
    far_end.line.ask("fail", device="drive", what="emergency", value=0x3220)
    session.wait_for(lambda: any("0x3220" in notice for notice in session.notices), 8.0, "the emergency")
    far_end.line.ask("fail", device="drive", what="emergency", value=0)


def falls_silent(session: Session, _: VirtualRigProcess, __: pytest.MonkeyPatch) -> None:
    session.devices.send("laser_x", b"OUTPUT NONE\n")
    session.wait_for(lambda: bool(session.notices), 8.0, "the silence")


def is_lost(session: Session, _: VirtualRigProcess, __: pytest.MonkeyPatch) -> None:
    session._links._readers["laser_y"].link.close()
    session.wait_for(lambda: bool(session.notices), 8.0, "the loss")


def fills_the_disk(session: Session, _: VirtualRigProcess, patch: pytest.MonkeyPatch) -> None:
    full = shutil.disk_usage(".")._replace(free=1_000_000)
    patch.setattr("daq.acquisition.recorder.shutil.disk_usage", lambda path: full)
    waits_for_trouble(session)


def is_stopped(_: Session, __: VirtualRigProcess, ___: pytest.MonkeyPatch) -> None:
    raise KeyboardInterrupt


SCENARIOS: dict[str, tuple[Trip, str]] = {
    "drop-out": (drops_out, "the drive entered FAULT without a command"),
    "emergency": (has_an_emergency, "emergency 0x3220"),
    "silent line": (falls_silent, "laser_x: silent for 2 s"),
    "lost device": (is_lost, "laser_y|closed|descriptor|gone"),
    "disk": (fills_the_disk, "the disk is full"),
    "operator": (is_stopped, "Ctrl-C"),
}
"""What makes each row trip, and the words in the log's summary."""


@pytest.mark.parametrize("row", SESSION, ids=lambda row: row.name)
def test_every_row_of_the_session_trips_and_stands_in_the_log(
    row, far_end: VirtualRigProcess, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert row.name in SCENARIOS, f"{row.name}: no scenario trips it"
    trips, words = SCENARIOS[row.name]
    rig = load_rig("virtual", settings=[*far_end.port_settings(), LATE_BEATS])
    ended: BaseException | None = None
    try:
        with Session(rig, far_end.clock) as session:
            session.start_recording(tmp_path / "a.mcap", {"test": "record"})
            trips(session, far_end, monkeypatch)
            session.stop_recording({})
    except BaseException as error:  # the error depends on the row
        ended = error
    monkeypatch.undo()
    with open_log(tmp_path / "a.mcap") as log:
        summary = {key: json.loads(text) for key, text in log.metadata["summary"].items()}
    continues = "continues" in row.reaction
    assert (ended is None) == continues
    found = " ".join(summary["warnings"]) if continues else summary["ended"]
    assert any(each in found for each in words.split("|")), found
    assert far_end.line.ask("state")["drive"] != cia402.OPERATION_ENABLED
    if row.name == "drop-out":  # clear the fault and wait for the boot-up, which would disturb the next session
        far_end.line.ask("fail", device="drive", what="restart")
        end = far_end.line.ask("state")["time_s"] + 2.0
        while far_end.line.ask("state")["time_s"] < end:
            threading.Event().wait(0.02)


def test_every_scenario_is_of_a_row() -> None:
    assert set(SCENARIOS) == {row.name for row in SESSION}
