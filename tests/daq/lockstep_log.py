"""Log of some seconds of a simulated rig at rest, on simulated time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from daq.acquisition.session import Session
from daq.lockstep.rig import LockstepRig
from rig_configs import load_rig
from rig_configs.schema import Rig


def recorded_at_rest(file: Path, log: Path, settings: Sequence[str] = (), seconds: float = 4.0) -> Rig:
    """Record a log of a rig file; return the rig with its ports."""
    sim = LockstepRig(load_rig(file, settings=list(settings)))
    session = Session(load_rig(file, settings=[*settings, *sim.port_settings()]), sim.clock, edge=sim.edge)
    with session:
        session.start_recording(log, {"test": "record"})
        sim.clock.wait(seconds)
        session.stop_recording({})
    return session.rig
