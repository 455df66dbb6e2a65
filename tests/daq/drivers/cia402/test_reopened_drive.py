"""A drive that sends requests by itself, in a session that opens it again."""

from __future__ import annotations

from typing import Any

import pytest

from daq.acquisition.session import Session
from daq.lockstep.rig import LockstepRig
from rig_configs import load_rig
from rig_drivers.modbus_converter.control import ConverterControl
from rig_drivers.modbus_converter.driver import DRIVER


def test_a_drive_sends_nothing_by_itself_while_it_is_opened_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its requests and those of the dialogue would get each other's answers."""
    sim = LockstepRig(load_rig("analogue_lasers", settings=["virtual.seed=5"]))
    rig = load_rig("analogue_lasers", settings=["virtual.seed=5", *sim.port_settings()])
    sent: list[bytes] = []
    quiet: list[bool] = []
    open_again = DRIVER.open

    def reopened(device: str, settings: Any, talk: Any) -> dict[str, Any]:
        before = len(sent)
        try:
            return open_again(device, settings, talk)
        finally:
            quiet.append(len(sent) == before)

    with Session(rig, sim.clock, edge=sim.edge) as session:
        drive = session.drive
        assert isinstance(drive, ConverterControl)
        monkeypatch.setitem(vars(DRIVER), "open", reopened)
        monkeypatch.setattr(drive._line, "_send", sent.append)  # it does not arrive, as without supply
        sim.ask("fail", device="inverter", what="power", value=1, seconds=60.0)
        for _ in range(100):
            session.check()
            sim.clock.wait(0.05)
        assert sent, "it polls"
    assert quiet
    assert all(quiet)
