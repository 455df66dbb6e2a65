"""Terminals that must not be opened as a device's port.

The name of a pty is given to another program when its own has ended. A rig file with the ports of a virtual rig that
has ended may therefore name the terminal of a person. A terminal is the controlling terminal of its session's
processes. The far end of a virtual rig, or a pty of `socat`, is that of no process.
"""

from __future__ import annotations

import contextlib
import os
import stat
from pathlib import Path

_PROCESSES = Path("/proc")


def terminal_of(port: str) -> str:
    """Return the process whose controlling terminal a port is, in words; empty if it is no terminal.

    Only Linux lists the terminals of other processes. On other systems only the terminal of this process is found.
    """
    try:
        found = Path(port).stat()
    except (OSError, ValueError):  # usual: a URL, or no such port
        return ""
    if not stat.S_ISCHR(found.st_mode):
        return ""
    for folder in _PROCESSES.glob("[0-9]*"):
        with contextlib.suppress(OSError, ValueError, IndexError):  # usual: the process has ended
            line = (folder / "stat").read_text(errors="replace")
            name, _, fields = line.partition("(")[2].rpartition(")")
            if int(fields.split()[4]) == _number(found.st_rdev):
                return f"process {folder.name} ({name})"
    return "this process" if _is_own(found.st_rdev) else ""


def _number(device: int) -> int:
    """Convert a device number to that of /proc: bits 8 to 15 are the major, 0 to 7 and 20 to 31 the minor number."""
    major, minor = os.major(device), os.minor(device)
    return (minor & 0xFF) | (major & 0xFFF) << 8 | (minor & ~0xFF) << 12


def _is_own(device: int) -> bool:
    try:
        descriptor = os.open("/dev/tty", os.O_RDONLY | os.O_NOCTTY)
    except OSError:  # usual: this process has none
        return False
    try:
        return os.stat(os.ttyname(descriptor)).st_rdev == device
    except OSError:  # usual: its name is not visible here
        return False
    finally:
        os.close(descriptor)
