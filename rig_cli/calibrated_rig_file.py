"""Writing a calibration: the record next to the rig file, and the new numbers in the rig file."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomlkit

from rig_basics.texts import storable
from rig_basics.whole_file import written_whole
from rig_configs import RigFileError
from rig_configs.load import rig_from_text
from rig_configs.toml_text import read_text


def write_record(folder: Path, device: str, when: str, record: Mapping[str, Any]) -> Path:
    """Write the record of a calibration as JSON under a new name.

    Args:
        folder: of the file.
        device: calibrated device.
        when: date and time (UTC), as `calibrated` in the rig file.
        record: its content.
    Raises:
        OSError: it cannot be written, or exists.
    """
    stamp = when.replace("-", "").replace(":", "")
    path = folder / f"calibration-{device}-{stamp}.json"
    with path.open("x", encoding="utf-8") as file:
        file.write(f"{storable(json.dumps(record, indent=1, ensure_ascii=False))}\n")
    return path


def name_of_record(path: Path) -> str:
    """Return the name of a record for the rig file: file name and first digits of the SHA-256 of its content."""
    return f"{path.name} sha256:{hashlib.sha256(path.read_bytes()).hexdigest()[:16]}"


def old_values(rig_file: Path, device: str, names: Mapping[str, Any]) -> dict[str, Any]:
    """Return what the rig file contains for these settings; None for one that it does not contain."""
    table: Mapping[str, Any] = _document(read_text(rig_file), rig_file).unwrap()["devices"][device]
    return {name: table.get(name) for name in names}


def write_settings(rig_file: Path, device: str, values: Mapping[str, Any], expected: str) -> None:
    """Replace settings of a device in a rig file. Comments and order are kept; the file is replaced in one step.

    Args:
        rig_file: the file.
        device: name of the device.
        values: new values by name of the setting.
        expected: text of the file when it was loaded.
    Raises:
        RigFileError: the file was changed since it was loaded, or is invalid with the new values. It is not changed.
        OSError: it cannot be written. It is not changed.
    """
    path = rig_file.resolve()  # a link to the file stays a link
    if read_text(path) != expected:
        raise RigFileError(f"{rig_file}: the file was changed during the calibration; it is left as it is")
    document = _document(expected, path)
    table = document["devices"][device]
    for name, value in values.items():
        table[name] = value
    text = tomlkit.dumps(document)
    rig_from_text(str(rig_file), text)
    with written_whole(path) as part:
        part.write_bytes(text.encode())


def _document(text: str, source: Path) -> Any:
    try:
        return tomlkit.parse(text)
    except ValueError as error:
        raise RigFileError(f"{source}: not a TOML file: {error}") from error
