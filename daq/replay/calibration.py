"""Calibration file: corrected values for decoding a recording, applied to its rig file.

[devices.probe]
range_m = 0.02503          # also overrides the range that the sensor reported
[devices.node]
counts_per_revolution = 4096
"""

from __future__ import annotations

import difflib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from rig_configs.errors import RigFileError
from rig_configs.load import validate
from rig_configs.regular_file import need_regular
from rig_configs.schema import Rig
from rig_configs.toml_text import parse_toml, read_text


@dataclass(frozen=True)
class Calibration:
    """Corrected values by device and key.

    Attributes:
        source: path of the file, for messages.
        text: content of the file.
        devices: corrected values by device and key; "TABLE.KEY" for a table inside of the device's.
    """

    source: str
    text: str
    devices: Mapping[str, Mapping[str, Any]]

    @classmethod
    def load(cls, path: str | Path) -> Calibration:
        """Read a calibration file.

        Raises:
            RigFileError: it cannot be read, is not TOML, or has other tables than devices; contains the nearest name.
        """
        try:
            need_regular(path)
            text = read_text(Path(path))
        except OSError as fault:
            raise RigFileError(f"{path}: expected a calibration file, cannot read it as text: {fault}") from fault
        raw = parse_toml(text, str(path))
        return cls(str(path), text, _devices(raw, str(path)))

    def correct(self, rig: Rig) -> Rig:
        """Return the rig file with the corrected values.

        Raises:
            RigFileError: an unknown device, or a key that is not a calibration value (the text contains the nearest
                name), or an invalid value.
        """
        raw = rig.model_dump(exclude_none=True)
        _only(self.devices, tuple(rig.devices), "devices.", self.source)
        for device, table in self.devices.items():
            _only(table, rig.devices[device].calibration, f"devices.{device}.", self.source)
            for key, value in table.items():
                *path, name = key.split(".")
                part = raw["devices"][device]
                for step in path:
                    part = part.setdefault(step, {})
                part[name] = value
        return validate(raw, self.source)

    def correct_identities(self, identities: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
        """Return the devices' identities, with corrected ranges in place of those that the sensors reported.

        A laser is decoded with the range that it reported when it was opened, not with the range in the rig file. The
        reported range is kept as ``told_range_m``.
        """
        corrected = {device: dict(identity) for device, identity in identities.items()}
        for device, table in self.devices.items():
            identity = corrected.get(device, {})
            if "range_m" in table and "range_m" in identity:
                reported = {"told_range_m": identity["range_m"]}
                corrected[device] = {**identity, **reported, "range_m": float(table["range_m"])}
        return corrected


def _devices(raw: Mapping[str, Any], source: str) -> dict[str, dict[str, Any]]:
    _only(raw, ("devices",), "", source)
    devices = _table(raw.get("devices", {}), "devices", source)
    found = {device: _flat(_table(table, f"devices.{device}", source)) for device, table in devices.items()}
    if not any(found.values()):
        raise RigFileError(f"{source}: expected a table like [devices.NAME] with a calibration, found none")
    return found


def _flat(table: Mapping[str, Any]) -> dict[str, Any]:
    """Return a table with the values of tables inside under "TABLE.KEY"."""
    found: dict[str, Any] = {}
    for key, value in table.items():
        if isinstance(value, dict):
            inside = _flat(cast("dict[str, Any]", value))
            found |= {f"{key}.{name}": each for name, each in inside.items()}
        else:
            found[key] = value
    return found


def _table(value: Any, key: str, source: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise RigFileError(f"{source}: {key}: expected a table, got {json.dumps(value, default=str)}")
    return cast("dict[str, Any]", value)


def _only(table: Mapping[str, Any], known: tuple[str, ...], place: str, source: str) -> None:
    """Raise for the first key that is not a calibration value; the message contains the nearest valid one."""
    for key in table:
        if key in known:
            continue
        near = [name for name in known if name.startswith(f"{key}_")] or difflib.get_close_matches(key, known, 1, 0.5)
        hint = f"; did you mean {place}{near[0]}?" if near else ""
        raise RigFileError(
            f"{source}: {place}{key}: expected a calibration{hint} Valid here: {', '.join(known)}. Connections and "
            "sampling rates cannot be changed afterwards"
        )
