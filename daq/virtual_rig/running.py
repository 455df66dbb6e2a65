# pyright: strict
"""Finding a virtual rig that runs: the note it leaves for the hands, which only its user can read.

The note holds the control port and its token. It lies in a folder of the user's own ($XDG_RUNTIME_DIR, or what the
system has in its place) and is removed at the rig's end. A note whose rig was killed is found out by its dead port.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from daq.errors import DeviceError
from daq.virtual_rig.control import OperatorLine
from rig_configs.errors import RigConfigError

_FOLDER = "pendulum-balancer-rig"
_START_ONE = "start one in another terminal: rig virtual"


@dataclass(frozen=True)
class Running:
    """A virtual rig that runs.

    Attributes:
        rig: name of its rig file.
        pid: of its process.
        control_port, token: of its control port.
        time_scale: seconds of rig time per wall second.
        ports: of its devices, by their names in the rig file.
    """

    rig: str
    pid: int
    control_port: int
    token: str
    time_scale: float
    ports: Mapping[str, str]


def notes_folder() -> Path:
    """Where rigs of this user leave their notes; made where it is missing.

    Raises:
        DeviceError: others could read or change what is in it.
    """
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    if sys.platform == "win32":
        folder = Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local") / _FOLDER / "running"
        folder.mkdir(parents=True, exist_ok=True)  # the user's profile is closed to others
        return folder
    folder = Path(runtime) / _FOLDER if runtime else Path(tempfile.gettempdir()) / f"{_FOLDER}-{os.getuid()}"
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    found = folder.lstat()
    if folder.is_symlink() or found.st_uid != os.getuid() or found.st_mode & 0o077:
        raise DeviceError(
            f"{folder}: expected a folder that you alone can use, since it is to hold a token; "
            "remove it, or name a file of your own with --control"
        )
    return folder


def leave_note(running: Running, path: Path | None = None) -> Path:
    """Write a rig's note, readable by its user only; an older one by this name is replaced.

    Args:
        running: the rig.
        path: of the note; None: in `notes_folder`, named after the control port, which no two rigs share.

    Returns:
        The note's path.

    Raises:
        OSError: it cannot be written there.
    """
    path = notes_folder() / f"virtual-{running.control_port}.json" if path is None else path
    fresh = path.with_name(f"{path.name}.{running.pid}")
    fresh.unlink(missing_ok=True)
    with os.fdopen(os.open(fresh, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="utf-8") as file:
        json.dump(asdict(running), file)
    fresh.replace(path)
    return path


def read_note(path: Path) -> Running:
    """The rig that left a note.

    Raises:
        RigConfigError: the file is no such note.
        OSError: it cannot be read.
    """
    try:
        found: Any = json.loads(path.read_text(encoding="utf-8"))
        return Running(
            str(found["rig"]),
            int(found["pid"]),
            int(found["control_port"]),
            str(found["token"]),
            float(found["time_scale"]),
            {str(name): str(port) for name, port in found["ports"].items()},
        )
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise RigConfigError(f"{path}: expected the note of a virtual rig (see rig virtual --control)") from error


def reach(control: Path | None = None) -> tuple[Running, OperatorLine]:
    """The rig that runs, and a line to its control port.

    Args:
        control: its note; None: the one rig of this user that runs.

    Raises:
        DeviceError: none runs.
        RigConfigError: several run and none was chosen, or the file is no note.
    """
    if control is not None:
        try:
            running = read_note(control)
            return running, OperatorLine(running.control_port, running.token)
        except (FileNotFoundError, ConnectionError) as error:
            raise DeviceError(f"{control}: no virtual rig runs there; {_START_ONE} --control {control}") from error
    alive = _alive()
    if not alive:
        raise DeviceError(f"no virtual rig runs; {_START_ONE}")
    if len(alive) > 1:
        for _, _, line in alive:
            line.close()
        choices = "".join(f"\n  --control {path}   ({running.rig})" for path, running, _ in alive)
        raise RigConfigError(f"{len(alive)} virtual rigs run; choose one:{choices}")
    _, running, line = alive[0]
    return running, line


def _alive() -> list[tuple[Path, Running, OperatorLine]]:
    """The rigs that answer; notes of those that were killed are removed."""
    found: list[tuple[Path, Running, OperatorLine]] = []
    for path in sorted(notes_folder().glob("virtual-*.json")):
        try:
            running = read_note(path)
        except (OSError, RigConfigError):
            continue  # it is being removed, or is none of ours
        try:
            line = OperatorLine(running.control_port, running.token)
        except ConnectionRefusedError:
            path.unlink(missing_ok=True)
            continue
        except OSError:
            continue
        try:
            line.ask("truth")
        except (OSError, ValueError):  # another program has the port now
            line.close()
            with contextlib.suppress(OSError):
                path.unlink()
            continue
        found.append((path, running, line))
    return found
