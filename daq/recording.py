"""Open a rig and record it, in two calls: the entry points for scripts and notebooks."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from daq.acquisition.session import Session
from daq.log.file import ReservedName
from daq.transports import HostClock
from rig_configs import Rig, load_rig

POLL_S = 0.05  # how often a recording looks for faults


def open_rig(rig: Rig | str | Path, *, notify: Callable[[str], None] = lambda text: None) -> Session:
    """Open every device of a rig and start its streams.

    Use the result in a `with` statement. At its end the rotor is stopped and every port is closed.

    Args:
        rig: a loaded rig, a rig file, or the name of a shipped rig.
        notify: called with each line that the operator has to read at once.
    Returns:
        The open session.
    Raises:
        RigFileError: the rig file is invalid, or two devices use the same port.
        LinkLost: a port cannot be opened.
        DeviceError: a device does not respond as configured.
    """
    loaded = rig if isinstance(rig, Rig) else load_rig(rig)
    return Session(loaded, HostClock(), notify=notify).open()


def record(session: Session, path: str | Path, seconds: float, metadata: Mapping[str, str] | None = None) -> Path:
    """Record all devices of an open rig for a fixed time.

    A device that is unplugged while the rotor is at rest does not end the recording: its loss is counted, and its port
    is opened again when it returns. The loss of the last device that is left ends it. While the rotor turns, an
    interlock stops the rotor and ends the recording.

    Args:
        session: from `open_rig`.
        path: the new log, NAME.mcap. An existing file is not overwritten.
        seconds: duration, s.
        metadata: facts to keep in the log, for example {"test": "record", "note": "new spring"}.
    Returns:
        Path of the finished log.
    Raises:
        LogError: the name does not end in .mcap, or the file exists.
        RecordingError: the file cannot be created, or the disk is full.
        LinkLost, DeviceError: a device or an interlock ended the recording. The log is closed and contains everything
            up to the failure.
    """
    with ReservedName(Path(path)) as name:
        session.start_recording(name, {"test": "record", **(metadata or {})})
        end_ns = session.clock.now_ns() + round(seconds * 1e9)
        try:
            while session.clock.now_ns() < end_ns:
                session.check()
                session.clock.wait(POLL_S)
        except BaseException as error:
            session.stop_recording({"ended": str(error) or type(error).__name__})
            raise
        return session.stop_recording({"ended": "duration"})
