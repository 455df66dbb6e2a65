"""What a log says of the rig it was recorded on."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from pydantic import ValidationError

from daq.errors import LogError
from daq.log import Log
from rig_configs.device import StoredDevice
from rig_configs.drivers import installed
from rig_configs.errors import RigConfigError
from rig_configs.load import apply_setting, parse_setting, validate
from rig_configs.schema import Rig

RIG, IDENTITIES, ROLES, CLOCKS = "rig.json", "identities.json", "roles.json", "clocks.json"
_LONGEST_RANGE_M = 1e3


def snapshot_of(log: Log) -> dict[str, Any]:
    """The rig file as it was when the log was recorded, as a raw table.

    Raises:
        LogError: the log has none, or one that cannot be read.
    """
    return _table(log, RIG)


def rig_of(log: Log, settings: Sequence[str] = ()) -> Rig:
    """The rig as it was when the log was recorded.

    Args:
        settings: "key=value" laid over it, for a what-if.

    Raises:
        LogError: the log has none, or one that this version cannot read.
        RigFileError: a setting that no rig file can have.
    """
    raw = snapshot_of(log)
    for text in settings:
        apply_setting(raw, *parse_setting(text), str(log.path))
    try:
        return validate(_with_stored(log, raw), f"{log.path}: {RIG}")
    except RigConfigError as fault:
        if settings:
            raise
        raise LogError(f"{fault}\nThe log was recorded with another version of the rig file") from fault


def _with_stored(log: Log, raw: dict[str, Any]) -> dict[str, Any]:
    """The same, with the roles that the log keeps in place of settings whose driver is not installed here."""
    devices = raw.get("devices")
    if ROLES not in log.attachments or not isinstance(devices, dict):
        return raw
    roles = _table(log, ROLES)
    unknown = [
        name
        for name, table in devices.items()
        if isinstance(table, dict) and isinstance(table.get("driver"), str) and table["driver"] not in installed()
    ]
    for name in unknown:
        try:
            devices[name] = StoredDevice.model_validate({**devices[name], "stored_roles": roles.get(name, [])})
        except ValidationError as fault:
            raise LogError(f"{log.path}: {ROLES}: {name}: cannot be what a device is to a rig: {fault}") from fault
    return raw


def identities_of(log: Log) -> dict[str, dict[str, Any]]:
    """What each device said of itself when it was opened; empty where nothing was asked.

    Raises:
        LogError: it cannot be what a device said, or names a range that no sensor has.
    """
    if IDENTITIES not in log.attachments:
        return {}
    identities = _table(log, IDENTITIES)
    for device, told in identities.items():
        place = f"{log.path}: {IDENTITIES}: {device}"
        if not isinstance(told, dict):
            raise LogError(f"{place}: expected a table of what the device said, got {type(told).__name__}")
        _check_range(told.get("range_m", 1.0), place)
    return identities


def seeds_of(log: Log) -> dict[str, Any]:
    """How the devices' clocks stood when the log began, tables of `ClockSeed` by device; empty where nobody knew.

    Raises:
        LogError: the attachment is no table.
    """
    return _table(log, CLOCKS) if CLOCKS in log.attachments else {}


def _check_range(value: Any, place: str) -> None:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not is_number or not 0 < value < _LONGEST_RANGE_M:
        raise LogError(f"{place}.range_m: expected a range above 0 m, got {str(value)[:60]!r}")


def _table(log: Log, name: str) -> dict[str, Any]:
    if name not in log.attachments:
        lacking = f" (the file is incomplete: {'; '.join(map(str, log.missing))})" if log.missing else ""
        raise LogError(
            f"{log.path}: expected the attachment {name!r} of a log of this rig, found {sorted(log.attachments)}"
            f"{lacking}. A recording made elsewhere becomes a log with `rig import`"
        )
    try:
        table = json.loads(log.attachments[name])
    except (ValueError, RecursionError) as fault:
        raise LogError(f"{log.path}: expected JSON in the attachment {name!r}, got something else ({fault})") from fault
    if not isinstance(table, dict):
        raise LogError(f"{log.path}: expected a table in the attachment {name!r}, got {type(table).__name__}")
    return table
