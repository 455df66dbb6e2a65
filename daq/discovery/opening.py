"""Opening of a port for the search, and the reasons why it cannot be opened."""

from __future__ import annotations

import errno
import logging
import os
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

from daq.drivers.contract import DeviceLine
from daq.errors import AcquisitionError, LinkLost
from daq.transports import Link, open_link
from rig_basics.ignoring import ignoring

if sys.platform != "win32":
    import grp

_log = logging.getLogger(__name__)

_PROCESSES = Path("/proc")
_TERMINAL = re.compile(r"/dev/(pts/\d+|ttys\d+)")
_LOCKED = (errno.EAGAIN, errno.EBUSY)
_DENIED = (errno.EACCES, errno.EPERM)

State = Literal["in use", "no permission", "not opened"]
"""Why a port cannot be opened."""


class PortNotOpened(AcquisitionError):
    """A port that cannot be opened; `state` is the reason, the message contains what to do."""

    def __init__(self, state: State, text: str) -> None:
        super().__init__(text)
        self.state: State = state


def has_line_rate(port: str) -> bool:
    """Whether the rate of a port's line matters: a serial port. Terminals of programs (ptys), TCP and CAN have none.

    A link counts as the port to which it leads.
    """
    return "://" not in port and not port.startswith("can:") and not _TERMINAL.fullmatch(os.path.realpath(port))


def open_port(line: DeviceLine) -> Link:
    """Open a port that no other program has open.

    Raises:
        PortNotOpened: another program has it open, the user may not open it, or it does not exist.
    """
    for program in programs_with(line.port):
        raise PortNotOpened("in use", f"open in another program ({program}); it is not disturbed")
    try:
        bitrate = line.bitrate if line.port.startswith("can:") else None  # a serial port may be no adapter's: as it is
        return open_link(line.port, line.baud, bitrate, line.parity)
    except LinkLost as error:
        raise _reason(line.port, error) from error


def _reason(port: str, error: LinkLost) -> PortNotOpened:
    code = getattr(error.__cause__, "errno", None)
    denied = code in _DENIED or "PermissionError(13" in str(error)
    if code in _LOCKED or (denied and sys.platform == "win32"):  # Windows denies access to an open port
        return PortNotOpened("in use", "open in another program; it is not disturbed")
    if denied:
        return PortNotOpened("no permission", f"you may not open it. {_remedy(port)}")
    return PortNotOpened("not opened", str(error))


def _remedy(port: str) -> str:
    """Return what gives the user the permission to open a port."""
    if sys.platform != "linux":
        return "Give your account access to the port"
    group = "dialout"
    with ignoring(_log, "reading the group of a port", OSError, KeyError):
        group = grp.getgrgid(os.stat(port).st_gid).gr_name
    if group == "root":
        return f"Only root may: add a udev rule for the adapter, or use its group (ls -l {port})"
    return f"Add yourself to the group {group} (sudo usermod -aG {group} $USER), log out and in again"


def programs_with(port: str) -> Iterator[str]:
    """Yield the other programs that have a serial port open, also those that do not lock it.

    Linux only, and only programs whose open files this user may see. Reading from such a port takes its bytes.
    """
    device = os.path.realpath(port)
    if sys.platform != "linux" or not has_line_rate(device):  # a simulated device may have both ends of its pty open
        return
    for folder in _PROCESSES.glob("[0-9]*"):
        if folder.name == str(os.getpid()):
            continue
        with ignoring(_log, "reading the open files of a program", OSError):  # it has ended, or belongs to another user
            if any(os.readlink(file) == device for file in (folder / "fd").iterdir()):
                yield f"{(folder / 'comm').read_text(errors='replace').strip()}, process {folder.name}"
