# pyright: strict
"""The ports of a rig file: which are placeholders, and which two devices name alike."""

from __future__ import annotations

import re
from collections.abc import Mapping

from rig_configs.device import DeviceSettings
from rig_configs.errors import RigFileError

PRINTED = "printed by `rig virtual`"
"""The port of every device in the shipped rig files."""

_NO_NAME = re.compile(r"(?i)|-+|none|todo|tbd|com|.*[?*…<>\s].*|.*(?:tty[a-z]*|com)x+")
_WINDOWS_DEVICE = "\\\\?\\"  # begins a path, and means itself


def is_placeholder(port: str) -> bool:
    """Whether a port is a text that no port bears: it waits for the real one.

    Args:
        port: as in the rig file. In a URL (`socket://…`) a question mark means itself.
    """
    if "://" in port or port.startswith(_WINDOWS_DEVICE):
        return " " in port
    return _NO_NAME.fullmatch(port) is not None


def refuse_shared_ports(devices: Mapping[str, DeviceSettings], source: str = "") -> None:
    """Two devices on one line: a bus alone can have several, and a placeholder is no line yet.

    Args:
        devices: of a rig file, by name.
        source: the file, for the message.

    Raises:
        RigFileError: naming both devices and the port.
    """
    first: dict[str, str] = {}
    for name, device in devices.items():
        if device.port.startswith("can:") or is_placeholder(device.port):
            continue
        if (other := first.setdefault(device.port, name)) != name:
            place = f"{source}: " if source else ""
            raise RigFileError(
                f"{place}devices.{other}.port and devices.{name}.port are both {device.port!r}: a line has one "
                "device. Give each the port that it is plugged into"
            )
