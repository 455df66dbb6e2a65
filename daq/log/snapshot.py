"""Facts that a log contains about the rig it was recorded on."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any, cast

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
_TOPICS_SHOWN = 20


def snapshot_of(log: Log) -> dict[str, Any]:
    """Return the rig file as it was when the log was recorded, as a raw table.

    Raises:
        LogError: the log does not contain it, or it cannot be read.
    """
    return _table(log, RIG)


def rig_of(log: Log, settings: Sequence[str] = ()) -> Rig:
    """Return the rig as it was when the log was recorded.

    Args:
        settings: "key=value" texts that replace values of the rig file, for what-if studies.

    Raises:
        LogError: the log does not contain the rig file, or this version cannot read it.
        RigFileError: a setting is not valid in a rig file.
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
    """Replace the settings of devices whose driver is not installed by the roles that are stored in the log."""
    devices = raw.get("devices")
    if ROLES not in log.attachments or not isinstance(devices, dict):
        return raw
    roles = _table(log, ROLES)
    tables = cast("dict[str, Any]", devices)
    for name, table in tables.items():
        if not _lacks_driver(table):
            continue
        try:
            tables[name] = StoredDevice.model_validate({**table, "stored_roles": roles.get(name, [])})
        except ValidationError as fault:
            raise LogError(f"{log.path}: {ROLES}: {name}: expected the roles of a device: {fault}") from fault
    return raw


def _lacks_driver(table: Any) -> bool:
    """Return True if a device's table names a driver that is not installed."""
    driver: object = cast("dict[str, Any]", table).get("driver") if isinstance(table, dict) else None
    return isinstance(driver, str) and driver not in installed()


def identities_of(log: Log) -> dict[str, dict[str, Any]]:
    """Return the identity that each device reported when it was opened; empty if no identities were queried.

    Raises:
        LogError: an identity is not a table, or contains an impossible range.
    """
    if IDENTITIES not in log.attachments:
        return {}
    identities = _table(log, IDENTITIES)
    for device, identity in identities.items():
        place = f"{log.path}: {IDENTITIES}: {device}"
        if not isinstance(identity, dict):
            raise LogError(f"{place}: expected a table of the device's identity, got {type(identity).__name__}")
        _check_range(cast("dict[str, Any]", identity).get("range_m", 1.0), place)
    return identities


def seeds_of(log: Log) -> dict[str, Any]:
    """Return the state of the devices' clocks at the log's start: tables of `ClockSeed` by device; empty if unknown.

    Raises:
        LogError: the attachment is not a table.
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
            f"{lacking}. It has the topics {', '.join(log.topics[:_TOPICS_SHOWN]) or 'none'}. What another program "
            "recorded becomes a log of this rig with `rig import`, once it is saved as csv, parquet, mat or hdf5"
        )
    try:
        table: Any = json.loads(log.attachments[name])
    except (ValueError, RecursionError) as fault:
        raise LogError(f"{log.path}: expected JSON in the attachment {name!r}, got something else ({fault})") from fault
    if not isinstance(table, dict):
        raise LogError(f"{log.path}: expected a table in the attachment {name!r}, got {type(table).__name__}")
    return cast("dict[str, Any]", table)
