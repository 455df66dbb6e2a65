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
    """What each device said of itself when it was opened; empty where nothing was asked."""
    return _table(log, IDENTITIES) if IDENTITIES in log.attachments else {}


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
