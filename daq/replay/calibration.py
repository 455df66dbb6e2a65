"""A calibration file: better numbers for what turned a recording's bytes into samples, laid over its rig file.

[devices.probe]
range_m = 0.02503          # overrides what the sensor said of itself, too
[devices.node]
counts_per_revolution = 4096
"""

from __future__ import annotations

import difflib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rig_configs.errors import RigFileError
from rig_configs.load import validate
from rig_configs.regular_file import need_regular
from rig_configs.schema import Rig
from rig_configs.toml_text import parse_toml, read_text


@dataclass(frozen=True)
class Calibration:
    """Corrected numbers by device and key.

    Attributes:
        source: the file, for messages.
        text: the file as it is.
    """

    source: str
    text: str
    devices: Mapping[str, Mapping[str, Any]]

    @classmethod
    def load(cls, path: str | Path) -> Calibration:
        """Read a calibration file.

        Raises:
            RigFileError: it cannot be read, is no TOML, or names anything but devices; gives the nearest name.
        """
        try:
            need_regular(path)
            text = read_text(Path(path))
        except OSError as fault:
            raise RigFileError(f"{path}: expected a calibration file, cannot read it as text: {fault}") from fault
        raw = parse_toml(text, str(path))
        return cls(str(path), text, _devices(raw, str(path)))

    def correct(self, rig: Rig) -> Rig:
        """The rig file with these numbers in it.

        Raises:
            RigFileError: no such device, or a key of it that is no calibration; gives the nearest name. Or a number
                that cannot be what its name says.
        """
        raw = rig.model_dump(exclude_none=True)
        _only(self.devices, tuple(rig.devices), "devices.", self.source)
        for device, table in self.devices.items():
            _only(table, rig.devices[device].calibration, f"devices.{device}.", self.source)
            raw["devices"][device] |= table
        return validate(raw, self.source)

    def correct_identities(self, identities: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
        """What the devices said, with a corrected range in place of what a sensor said of its own.

        A laser is decoded with the range it told when it was opened, before any the rig file names. What it told is
        kept beside it, as ``told_range_m``.
        """
        corrected = {device: dict(told) for device, told in identities.items()}
        for device, table in self.devices.items():
            told = corrected.get(device, {})
            if "range_m" in table and "range_m" in told:
                corrected[device] = {**told, "told_range_m": told["range_m"], "range_m": float(table["range_m"])}
        return corrected


def _devices(raw: Mapping[str, Any], source: str) -> dict[str, dict[str, Any]]:
    _only(raw, ("devices",), "", source)
    devices = _table(raw.get("devices", {}), "devices", source)
    found = {device: _table(table, f"devices.{device}", source) for device, table in devices.items()}
    if not any(found.values()):
        raise RigFileError(f"{source}: expected a table like [devices.NAME] with a calibration, found none")
    return found


def _table(value: Any, key: str, source: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise RigFileError(f"{source}: {key}: expected a table, got {json.dumps(value, default=str)}")
    return value


def _only(table: Mapping[str, Any], known: tuple[str, ...], place: str, source: str) -> None:
    """Refuse the first key that is no calibration, with the nearest one that is."""
    for key in table:
        if key in known:
            continue
        near = [name for name in known if name.startswith(f"{key}_")] or difflib.get_close_matches(key, known, 1, 0.5)
        hint = f"; did you mean {place}{near[0]}?" if near else ""
        raise RigFileError(
            f"{source}: {place}{key}: expected a calibration{hint} Known here: {', '.join(known)}. What was plugged in "
            "and how fast it measured cannot be changed afterwards"
        )
