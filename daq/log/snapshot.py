"""What a log says of the rig it was recorded on."""

from __future__ import annotations

import json
from typing import Any

from daq.errors import LogError
from daq.log import Log
from rig_configs.errors import RigConfigError
from rig_configs.load import validate
from rig_configs.schema import Rig

RIG, IDENTITIES = "rig.json", "identities.json"
_NEEDED_WORDS = ("DIST", "COUNTER", "TIMESTAMP_LO", "TIMESTAMP_HI")
_MOST_WORDS, _LONGEST_RANGE_M = 32, 1e3


def snapshot_of(log: Log) -> dict[str, Any]:
    """The rig file as it was when the log was recorded, as a raw table.

    Raises:
        LogError: the log has none, or one that cannot be read.
    """
    return _table(log, RIG)


def rig_of(log: Log) -> Rig:
    """The rig as it was when the log was recorded.

    Raises:
        LogError: the log has none, or one that this version cannot read.
    """
    try:
        return validate(snapshot_of(log), f"{log.path}: {RIG}")
    except RigConfigError as fault:
        raise LogError(f"{fault}\nThe log was recorded with another version of the rig file") from fault


def identities_of(log: Log) -> dict[str, dict[str, Any]]:
    """What each device said of itself when it was opened; empty where nothing was asked.

    Raises:
        LogError: it cannot be what a device said; a range or a laser's words that no stream can be decoded with.
    """
    if IDENTITIES not in log.attachments:
        return {}
    identities = _table(log, IDENTITIES)
    for device, told in identities.items():
        place = f"{log.path}: {IDENTITIES}: {device}"
        if not isinstance(told, dict):
            raise LogError(f"{place}: expected a table of what the device said, got {type(told).__name__}")
        _check_range(told.get("range_m", 1.0), place)
        if device.startswith("laser") and "words" in told:
            _check_words(told["words"], place)
    return identities


def _check_range(value: Any, place: str) -> None:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not is_number or not 0 < value < _LONGEST_RANGE_M:
        raise LogError(f"{place}.range_m: expected a range above 0 m, got {str(value)[:60]!r}")


def _check_words(value: Any, place: str) -> None:
    names = value if isinstance(value, list) and all(isinstance(name, str) for name in value) else []
    if not 0 < len(names) <= _MOST_WORDS or len({*names}) < len(names) or not {*_NEEDED_WORDS} <= {*names}:
        raise LogError(
            f"{place}.words: expected the words of the laser's stream, each once, {', '.join(_NEEDED_WORDS)} among "
            f"them, got {str(value)[:60]!r}"
        )


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
