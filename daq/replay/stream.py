"""A log's raw bytes through fresh pipelines: what live recording did, done again, in bounded memory."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from daq.clock import CLOCK_RULES, FIRST_RULES, NEWEST_RULES
from daq.drivers.contract import Pipeline
from daq.drivers.devices import installed_of, make_pipelines
from daq.drivers.items import Batch, Event
from daq.errors import DeviceError, LogError
from daq.log import Log
from daq.log.samples import RawChunk
from daq.log.snapshot import identities_of, rig_of, seeds_of
from rig_configs.schema import Rig

Decoded = tuple[str, RawChunk, list[Batch | Event]]
"""A device, bytes of one read or write, and what its pipeline made of them."""


def pipelines_of(log: Log) -> dict[str, Pipeline]:
    """Fresh pipelines as they were when the log was recorded.

    Raises:
        LogError: the log holds no raw bytes, or not what is needed to decode them.
    """
    if not log.devices:
        raise LogError(f"{log.path}: holds no raw bytes (it was not recorded from devices): nothing to decode again")
    identities = identities_of(log)
    for device, told in identities.items():
        if not isinstance(told, dict):
            raise LogError(f"{log.path}: identities.json: expected a table under {device!r:.80}, got {told!r:.80}")
    return pipelines_with(rig_of(log), identities, str(log.path), log)


def rules_of(log: Log) -> int:
    """By which rules its clock maps went when it was recorded: those of a log that says nothing are the first.

    Raises:
        LogError: this version knows no such rules.
    """
    told = log.metadata.get("run", {}).get(CLOCK_RULES, str(FIRST_RULES))
    known = [str(rules) for rules in range(FIRST_RULES, NEWEST_RULES + 1)]
    if told not in known:
        raise LogError(
            f"{log.path}: expected {CLOCK_RULES} {' or '.join(known)} among its facts, got {told!r:.80}: "
            "it was recorded by a newer version; decode it with that one"
        )
    return int(told)


def pipelines_with(
    rig: Rig, identities: Mapping[str, Mapping[str, Any]], source: str, log: Log | None = None
) -> dict[str, Pipeline]:
    """Fresh pipelines for devices that said this of themselves.

    Args:
        source: of the identities, for a message.
        log: whose bytes they are to decode: their clock maps begin as they did then.

    Returns:
        By device; without those of a log whose driver is not installed here.

    Raises:
        LogError: no such device can have said it.
    """
    try:
        if log is None:
            return make_pipelines(installed_of(rig.devices), identities)
        return make_pipelines(installed_of(rig.devices), identities, rules_of(log), seeds_of(log))
    except DeviceError as fault:
        raise LogError(f"{source}: identities.json: {fault}: its bytes cannot be decoded") from fault


def decoded(log: Log, pipelines: Mapping[str, Pipeline]) -> Iterator[Decoded]:
    """Every raw read and write in file order, with what the device's pipeline makes of it.

    Bytes of devices without a pipeline are handed on with nothing made of them.

    Raises:
        LogError: raw bytes in the log are not what its schema says.
    """
    for device, chunk in log.raw_in_order():
        pipeline = pipelines.get(device)
        yield device, chunk, [] if pipeline is None else pipeline.feed(chunk.direction, chunk.data, chunk.host_ns)
