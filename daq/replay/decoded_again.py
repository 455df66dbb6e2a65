"""Decoding of a log into a new one: the same raw bytes, samples and events from present decoders and calibration."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from daq.channels import EVENTS_TOPIC, HEALTH_TOPIC, Channel
from daq.drivers.calibrated import CalibratedPipeline
from daq.drivers.devices import channels_of
from daq.items import Batch, joined
from daq.log import Log, open_log
from daq.log.file import FOXGLOVE, LogFile
from daq.log.outcome import summary_of
from daq.log.snapshot import identities_of, rig_of
from daq.log.verdicts import digest_of
from daq.replay.calibration import Calibration
from daq.replay.checking import Progress, share_of
from daq.replay.compare import ChannelCheck, ChannelComparison
from daq.replay.stream import decoded, pipelines_of, pipelines_with
from daq.version import DECODER, software_version

_TOGETHER_NS = 50_000_000  # samples of a channel that arrived within this time are written together, as in a recording
_ORIGIN_KEYS = ("origin", "origin_sha256", "origin_software", "calibration")
_REWRITTEN = ("run", "summary", "times", FOXGLOVE)


@dataclass(frozen=True)
class DecodedLog:
    """Result of decoding a log into a new one.

    Attributes:
        path: the new log.
        moved: comparison of the values with those of the origin, by channel; only the distances are significant.
        losses: losses counted while decoding, by device and kind.
        missing: missing parts of the origin, as sentences.
    """

    path: Path
    moved: tuple[ChannelCheck, ...]
    losses: Mapping[str, Mapping[str, int]]
    missing: tuple[str, ...]


def decode_again(
    path: str | Path, out: str | Path, calibration: Calibration | None = None, progress: Progress | None = None
) -> DecodedLog:
    """Decode a log's raw bytes into a new log that names its origin.

    Raw bytes, health reports and the host's own events keep their times. Samples and events of the devices are made
    again, and losses are counted again. A new log that cannot be finished is removed.

    Args:
        path: the log to decode.
        out: the new log.
        calibration: corrected values; None for the values of the log.
        progress: called with the completed share, 0 … 1.

    Raises:
        LogError: the file is not a readable log, it has no raw bytes, or `out` exists.
        RigFileError: the calibration does not fit the rig.
        RecordingError: `out` cannot be written.
    """
    with open_log(path) as log:
        pipelines_of(log)  # raises before anything is written
        rig, identities = rig_of(log), identities_of(log)
        if calibration is not None:
            rig, identities = calibration.correct(rig), calibration.correct_identities(identities)
        attachments = {
            **log.attachments,
            "rig.json": rig.snapshot_json(),
            "roles.json": rig.roles_json(),
            "rig.origin.json": log.attachments["rig.json"],
        }
        attachments["identities.json"] = json.dumps(identities).encode()
        attachments.pop("calibration.toml", None)
        if calibration is not None:
            attachments["calibration.toml"] = calibration.text.encode()
        pipelines = pipelines_with(rig, identities, str(path), log)
        facts = _facts(log, calibration)
        known = channels_of(rig.devices)
        new = LogFile(Path(out), facts, attachments, log.devices, time.time_ns(), known.values())
        with new.or_nothing():
            copy = _Copy(log, new, pipelines, known)
            copy.run(progress)
            missing = tuple(str(place) for place in log.missing)
            losses = {device: dict(pipeline.losses) for device, pipeline in pipelines.items()}
            made = new.finish(_summary(log, losses, missing))
        return DecodedLog(made, copy.moved(), losses, missing)


class _Copy:
    """Copies one log into another, everything in order of time."""

    def __init__(
        self, log: Log, new: LogFile, pipelines: Mapping[str, CalibratedPipeline], known: Mapping[str, Channel]
    ) -> None:
        self._log, self._new, self._pipelines = log, new, pipelines
        self._comparisons = {topic: ChannelComparison(log, channel, None, cut=True) for topic, channel in known.items()}
        self._waiting: dict[str, list[tuple[Batch, int]]] = {}
        self._since_ns = 0

    def run(self, progress: Progress | None) -> None:
        notes = [(HEALTH_TOPIC, note) for note in self._log.health]
        notes += [(EVENTS_TOPIC, note) for note in self._log.events if note.get("device") not in self._pipelines]
        notes.sort(key=lambda each: each[1]["time_ns"], reverse=True)
        share = share_of(self._log, progress)
        for device, chunk, items in decoded(self._log, self._pipelines):
            while notes and notes[-1][1]["time_ns"] <= chunk.host_ns:
                self._note(*notes.pop())
            if chunk.host_ns - self._since_ns > _TOGETHER_NS:
                self._write_samples()
                self._since_ns = chunk.host_ns
            self._new.raw(device, chunk.direction, chunk.data, chunk.host_ns)
            for item in items:
                if isinstance(item, Batch):
                    self._waiting.setdefault(item.channel.topic, []).append((item, chunk.host_ns))
                    self._comparisons[item.channel.topic].add(item, chunk.host_ns)
                else:
                    self._new.event(item, chunk.host_ns)
            share(chunk.host_ns)
        self._write_samples()
        while notes:
            self._note(*notes.pop())

    def moved(self) -> tuple[ChannelCheck, ...]:
        return tuple(comparison.result() for comparison in self._comparisons.values())

    def _note(self, topic: str, note: Mapping[str, Any]) -> None:
        facts = {key: value for key, value in note.items() if key != "time_ns"}
        self._new.note(topic, facts, note["time_ns"], note["time_ns"])

    def _write_samples(self) -> None:
        for arrived in self._waiting.values():
            self._new.batch(*joined(arrived))
        self._waiting = {}


def _facts(log: Log, calibration: Calibration | None) -> dict[str, str]:
    """Return the run's facts and its origin; facts about the origin's own origin are kept under another name."""
    run = log.metadata.get("run", {})
    facts = {(f"origin.{key}" if key in _ORIGIN_KEYS else key): value for key, value in run.items()}
    others = {name: table for name, table in log.metadata.items() if name not in _REWRITTEN}
    facts |= {f"origin.{name}": json.dumps(table, ensure_ascii=False) for name, table in others.items()}
    digest = digest_of(log.path).removeprefix("sha256:")
    facts |= {"origin": log.path.name, "origin_sha256": digest, "software": software_version()}
    facts["decoder"] = str(DECODER)
    facts["origin_software"] = run.get("software", "unknown")
    if calibration is not None:
        facts["calibration"] = calibration.text
    return facts


def _summary(log: Log, losses: Mapping[str, Any], missing: tuple[str, ...]) -> dict[str, Any]:
    """Return the origin's summary with the new losses; the origin's losses are kept under another name."""
    old = summary_of(log)
    if "losses" in old:
        old["losses_of_origin"] = old["losses"]
    if missing:
        old["missing_of_origin"] = list(missing)
    return {**old, "losses": losses}
