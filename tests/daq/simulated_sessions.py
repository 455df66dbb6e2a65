"""Sessions on simulated rigs and simulated time: opened, turning, recorded."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from daq.acquisition.session import Session
from daq.guided_tests.procedure import Procedures
from daq.lockstep.rig import LockstepRig
from daq.virtual_rig.simulated_operator import SimulatedOperator
from rig_configs import load_rig
from rig_configs.schema import Rig


def quiet(text: str, share: float | None) -> None:
    """No progress in tests."""


def opened(rig: str | Path, *settings: str, **options: Any) -> tuple[LockstepRig, Session]:
    """A simulated rig, and a session whose rig file states its ports; `options` are those of the session."""
    sim = LockstepRig(load_rig(rig, settings=list(settings)))
    pointed = load_rig(rig, settings=[*settings, *sim.port_settings()])
    return sim, Session(pointed, sim.clock, edge=sim.edge, **options)


def guided(
    session: Session, sim: LockstepRig, folder: Path, progress: Callable[[str, float | None], None] = quiet
) -> Procedures:
    """Guided tests whose operator is the simulated rig's own."""
    return Procedures(session, SimulatedOperator(sim), folder, progress)


def turn(session: Session, rpm: float) -> None:
    """Turn the rotor at a speed, as fast as its drive may."""
    session.drive.enable()
    session.drive.set_ramp(1000)
    session.drive.set_speed(rpm)
    session.wait_for(lambda: session.drive.actual_rpm > 0.9 * rpm, 5.0, "the rotor to turn")


@contextmanager
def recording(session: Session, log: Path) -> Iterator[None]:
    """Open the session, record a log meanwhile, and close it; an error leaves the log to the session."""
    with session:
        session.start_recording(log, {"test": "record"})
        yield
        session.stop_recording({})


def recorded_at_rest(rig: str | Path, log: Path, settings: Sequence[str] = (), seconds: float = 4.0) -> Rig:
    """Record a log of some seconds; return the rig with its ports."""
    sim, session = opened(rig, *settings)
    with recording(session, log):
        sim.clock.wait(seconds)
    return session.rig
