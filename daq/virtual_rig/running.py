"""Discovery of running virtual rigs: notes for the simulated operator that only their user can read.

A note contains the control port and its token. It is a file in a private folder of the user ($XDG_RUNTIME_DIR, or its
equivalent on the system) and is removed at the end of the rig. The port of a killed rig does not answer, which
identifies its note as outdated.
"""

from __future__ import annotations

import logging
import os
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from daq.errors import DeviceError
from daq.virtual_rig.control import OperatorLine
from rig_basics.ignoring import ignoring
from rig_basics.texts import number_of
from rig_configs.errors import RigConfigError

_log = logging.getLogger(__name__)

_FOLDER = "pendulum-balancer-rig"


class NoRigRuns(DeviceError):
    """No virtual rig answers."""


class SeveralRigsRun(RigConfigError):
    """Several virtual rigs run and none was chosen.

    Attributes:
        choices: path of the note and name of each running rig.
    """

    def __init__(self, choices: Sequence[tuple[Path, str]]) -> None:
        self.choices: tuple[tuple[Path, str], ...] = tuple(choices)
        rows = "".join(f"\n  {path}   ({rig})" for path, rig in self.choices)
        super().__init__(
            f"{number_of(len(self.choices), 'virtual rig runs', 'virtual rigs run')}; choose one by its note:{rows}"
        )


@dataclass(frozen=True)
class Running:
    """Data of a running virtual rig.

    Attributes:
        rig: name of the rig file.
        pid: process id.
        control_port, token: TCP port and token of the control port.
        ports: ports of the devices, by their names in the rig file.
    """

    rig: str
    pid: int
    control_port: int
    token: str
    ports: Mapping[str, str]


_NOTE: TypeAdapter[Running] = TypeAdapter(Running)


def notes_folder() -> Path:
    """Return the folder of the notes of this user. It is created if it is missing.

    Raises:
        DeviceError: other users could read or change its content.
    """
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    if sys.platform == "win32":
        folder = Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local") / _FOLDER / "running"
        folder.mkdir(parents=True, exist_ok=True)  # other users have no access to the user's profile
        return folder
    folder = Path(runtime) / _FOLDER if runtime else Path(tempfile.gettempdir()) / f"{_FOLDER}-{os.getuid()}"
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    found = folder.lstat()
    if folder.is_symlink() or found.st_uid != os.getuid() or found.st_mode & 0o077:
        raise DeviceError(
            f"{folder}: expected a folder that only you can access, since it contains a token; "
            "remove it, or choose another file for the note"
        )
    return folder


def leave_note(running: Running, path: Path | None = None) -> Path:
    """Write the note of a rig, readable by its user only. An older note of the same path is replaced.

    Args:
        running: the rig.
        path: path of the note; None for a file in `notes_folder` with the number of the control port in its name.

    Returns:
        Path of the note.

    Raises:
        OSError: the note cannot be written.
    """
    path = notes_folder() / f"virtual-{running.control_port}.json" if path is None else path
    fresh = path.with_name(f"{path.name}.{running.pid}")
    fresh.unlink(missing_ok=True)
    with os.fdopen(os.open(fresh, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
        file.write(_NOTE.dump_json(running))
    fresh.replace(path)
    return path


def read_note(path: Path) -> Running:
    """Read the note of a rig.

    Raises:
        RigConfigError: the file is not the note of a virtual rig.
        OSError: the file cannot be read.
    """
    try:
        return _NOTE.validate_json(path.read_bytes())
    except ValidationError as error:
        raise RigConfigError(f"{path}: expected the note of a virtual rig, as the rig writes it") from error


def reach(control: Path | None = None) -> tuple[Running, OperatorLine]:
    """Return a running rig and a connection to its control port.

    Args:
        control: path of its note; None for the only running rig of this user.

    Raises:
        NoRigRuns: no virtual rig runs.
        SeveralRigsRun: several rigs run and `control` is None.
        RigConfigError: the file is not a note.
    """
    if control is not None:
        try:
            running = read_note(control)
            return running, OperatorLine(running.control_port, running.token)
        except (FileNotFoundError, ConnectionError) as error:
            raise NoRigRuns(f"{control}: no virtual rig runs there; start one with this note") from error
    alive = [(path, *found) for path in sorted(notes_folder().glob("virtual-*.json")) if (found := _answering(path))]
    if not alive:
        raise NoRigRuns("no virtual rig runs; start one first")
    if len(alive) > 1:
        for _, _, line in alive:
            line.close()
        raise SeveralRigsRun([(path, running.rig) for path, running, _ in alive])
    _, running, line = alive[0]
    return running, line


def _answering(path: Path) -> tuple[Running, OperatorLine] | None:
    """Return the rig of a note if it answers. The note of a rig that was killed is removed."""
    line = None
    try:
        running = read_note(path)
        line = OperatorLine(running.control_port, running.token)
        line.ask("truth")
    except RigConfigError as error:
        _log.debug("note skipped: %s", error)
    except (OSError, ValueError) as error:  # no rig, or another program, uses the port now; the file may be gone
        _log.info("virtual rig of %s not reached: %s", path, error)
        if line is not None:
            line.close()
        if line is not None or isinstance(error, ConnectionRefusedError):
            with ignoring(_log, "removing a note", OSError):
                path.unlink(missing_ok=True)
    else:
        return running, line
    return None
