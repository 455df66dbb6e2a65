"""Tables of a rig file for devices that were found."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from daq.drivers.driver import Driver
from daq.drivers.identification import FoundDevice
from rig_configs.device import DisplacementSettings
from rig_configs.roles import DisplacementSensor, PendulumAngles, Role, SpeedSource

_AXES = ("x", "y")


@dataclass(frozen=True)
class Table:
    """A device for which a table is written.

    Attributes:
        driver: its driver.
        port: its port in the rig file.
        found: settings and identity.
        roles: roles of a device with the settings of the trial; empty if unknown.
    """

    driver: Driver
    port: str
    found: FoundDevice
    roles: tuple[Role, ...] = ()


def device_tables(tables: Iterable[Table]) -> list[tuple[str, str]]:
    """Return name and text of the table `[devices.NAME]` of each device, without equal names and axes.

    A required setting that the device does not report is a comment, so that the rig file is refused until it is set.
    """
    names: set[str] = set()
    out: list[tuple[str, str]] = []
    measured = 0
    for table in tables:
        own: dict[str, tuple[Any, str]] = {}
        if issubclass(table.driver.settings, DisplacementSettings):
            own = _axis(measured, table.driver.settings.names_its_channel)
            measured += 1
        name = _free(_name(table, measured), names)
        names.add(name)
        out.append((name, _text(name, table, own)))
    return out


def _axis(measured: int, can_be_witness: bool) -> dict[str, tuple[Any, str]]:
    """Return the settings of a displacement sensor's axis: x, then y, then witnesses of x."""
    if measured < len(_AXES) or not can_be_witness:
        return {"axis": (_AXES[measured % 2], "choose: the axis along which it measures, x or y")}
    channel = f"witness_{measured - len(_AXES) + 1}"
    return {
        "axis": (_AXES[0], "choose: the axis along which it measures, x or y"),
        "witness": (channel, "a further sensor of this axis; without it the sensor measures for the rig"),
    }


def _name(table: Table, measured: int) -> str:
    for role in table.roles:
        if isinstance(role, DisplacementSensor):
            return f"displacement_{_AXES[measured - 1] if measured <= len(_AXES) else measured}"
        if isinstance(role, PendulumAngles):
            return "node"
        if isinstance(role, SpeedSource):
            return "drive"
    return table.driver.name


def _free(name: str, names: Iterable[str]) -> str:
    taken = set(names)
    return name if name not in taken else next(f"{name}_{i}" for i in range(2, 1000) if f"{name}_{i}" not in taken)


def _text(name: str, table: Table, own: Mapping[str, tuple[Any, str]]) -> str:
    """Return a table with one setting a line, in the order of the settings class."""
    known = {"driver": table.driver.name, "port": table.port, **table.found.settings}
    lines = [f"[devices.{name}]"]
    if table.found.identity:
        lines.append(f"# {identity_words(table.found.identity)}")
    for key, field in table.driver.settings.model_fields.items():
        value, comment = own.get(key, (known.get(key), ""))
        if value is not None:
            lines.append(f"{key} = {_value(value)}{f'  # {comment}' if comment else ''}")
        elif field.is_required():
            lines.append(f"# {key} =   # required, and the device does not report it")
    return "\n".join(lines) + "\n"


def _value(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False)  # texts, numbers and flags are written as in TOML


def identity_words(identity: Mapping[str, str | int | float]) -> str:
    """Return an identity as one line of text without control characters."""
    text = ", ".join(f"{key} {value}" for key, value in identity.items())
    return "".join(letter if letter.isprintable() else " " for letter in text)
