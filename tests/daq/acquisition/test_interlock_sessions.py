"""The interlocks that the session evaluates (links, drive, disk, operator): each trips on a virtual rig."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from daq.acquisition.interlock_table import SESSION
from daq.acquisition.session import Session
from daq.drivers.cia402 import wire as cia402
from daq.lockstep.rig import LockstepRig
from daq.log import open_log
from rig_configs.schema import Rig

Trip = Callable[[Session, LockstepRig], None]


def waits_for_trouble(session: Session) -> None:
    session.wait_for(lambda: False, 8.0, "a trip")


def drops_out(session: Session, simulated: LockstepRig) -> None:
    session.drive.enable()
    simulated.ask("fail", device="drive", what="fault", value=0x3220)
    waits_for_trouble(session)


def has_an_emergency(session: Session, simulated: LockstepRig) -> None:
    simulated.ask("fail", device="drive", what="emergency", value=0x3220)
    session.wait_for(lambda: any("0x3220" in notice for notice in session.notices), 8.0, "the emergency")
    simulated.ask("fail", device="drive", what="emergency", value=0)


def falls_silent(session: Session, _: LockstepRig) -> None:
    session.devices.send("laser_x", b"OUTPUT NONE\n")
    session.wait_for(lambda: bool(session.notices), 8.0, "the silence")


def is_lost(session: Session, simulated: LockstepRig) -> None:
    simulated.ask("unplug", device="laser_y")
    session.wait_for(lambda: bool(session.notices), 8.0, "the loss")


def fills_the_disk(session: Session, simulated: LockstepRig) -> None:
    simulated.disk.room_bytes = 1_000_000
    waits_for_trouble(session)


def is_stopped(_: Session, __: LockstepRig) -> None:
    raise KeyboardInterrupt


SCENARIOS: dict[str, tuple[Trip, str]] = {
    "drop-out": (drops_out, "the drive entered FAULT without a command; emergency 0x3220, DC link under-voltage"),
    "emergency": (has_an_emergency, "emergency 0x3220"),
    "silent line": (falls_silent, "laser_x: silent for 2 s"),
    "lost device": (is_lost, "laser_y|closed|descriptor|gone"),
    "disk": (fills_the_disk, "the disk is full"),
    "operator": (is_stopped, "Ctrl-C"),
}
"""What makes each row trip, and the words in the log's summary."""


@pytest.mark.parametrize("row", SESSION, ids=lambda row: row.name)
def test_every_row_of_the_session_trips_and_stands_in_the_log(
    row, simulated: LockstepRig, cabled: Rig, tmp_path: Path
) -> None:
    assert row.name in SCENARIOS, f"{row.name}: no scenario trips it"
    trips, words = SCENARIOS[row.name]
    ended: BaseException | None = None
    try:
        with Session(cabled, simulated.clock, edge=simulated.edge) as session:
            session.start_recording(tmp_path / "a.mcap", {"test": "record"})
            trips(session, simulated)
            session.stop_recording({})
    except BaseException as error:  # the error depends on the row
        ended = error
    with open_log(tmp_path / "a.mcap") as log:
        summary = {key: json.loads(text) for key, text in log.metadata["summary"].items()}
    continues = "continues" in row.reaction
    assert (ended is None) == continues
    found = " ".join(summary["warnings"]) if continues else summary["ended"]
    assert any(each in found for each in words.split("|")), found
    assert simulated.ask("state")["drive"] != cia402.OPERATION_ENABLED


def test_every_scenario_is_of_a_row() -> None:
    assert set(SCENARIOS) == {row.name for row in SESSION}
