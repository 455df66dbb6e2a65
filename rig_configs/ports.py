"""Refusals of a rig file that opens devices: ports of two devices that are equal, locks whose state nothing reports."""

from __future__ import annotations

import re
from collections.abc import Mapping

from rig_configs.device import DeviceSettings
from rig_configs.errors import RigFileError
from rig_configs.roles import Roles

PRINTED = "printed by `rig virtual`"
"""The port of every device in the shipped rig files."""

_NO_NAME = re.compile(r"(?i)|-+|none|todo|tbd|com|.*[?*…<>\s].*|.*(?:tty[a-z]*|com)x+")
_WINDOWS_DEVICE = "\\\\?\\"  # start of a path in which a question mark is literal


def is_placeholder(port: str) -> bool:
    """Whether a port is a placeholder for the real one: a text that cannot be the name of a port.

    Args:
        port: port in the rig file. In a URL (`socket://…`) a question mark is literal.
    """
    if "://" in port or port.startswith(_WINDOWS_DEVICE):
        return " " in port
    return _NO_NAME.fullmatch(port) is not None


def refuse_shared_ports(devices: Mapping[str, DeviceSettings], source: str = "") -> None:
    """Check that no two devices have the same port; buses with several devices and placeholders are allowed.

    Args:
        devices: devices of a rig file by name.
        source: file, for the message.

    Raises:
        RigFileError: names both devices and the port.
    """
    first: dict[str, str] = {}
    for name, device in devices.items():
        if device.port.startswith("can:") or is_placeholder(device.port):
            continue
        if (other := first.setdefault(device.port, name)) != name:
            place = f"{source}: " if source else ""
            raise RigFileError(
                f"{place}devices.{other}.port and devices.{name}.port are both {device.port!r}: a port has one "
                "device. Give each the port that it is plugged into; several devices behind one CAN adapter need a "
                "network interface (can:socketcan:…)"
            )


def refuse_unseen_locks(roles: Roles, source: str = "") -> None:
    """Check that the device that moves the locks also reports their state, with its samples of the pendulums' angles.

    Args:
        roles: roles of a rig file's devices.
        source: file, for the message.

    Raises:
        RigFileError: names the device and what to set.
    """
    locks, angles = roles.locks, roles.angles
    if locks is None or (angles is not None and angles.device == locks.device):
        return
    place = f"{source}: " if source else ""
    measured = "no device measures the angles" if angles is None else f"{angles.device} measures the angles"
    raise RigFileError(
        f"{place}devices.{locks.device} moves the locks and reports their state with its angles, but {measured}: no "
        f"test could see them close. Set devices.{locks.device}.angles = true, or locks = false to lock the pendulums "
        "by hand"
    )
