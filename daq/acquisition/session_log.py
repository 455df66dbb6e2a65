"""The log of a session: one recording after another, each with new pipelines and with the clock states of the last."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from daq.acquisition.core import Core
from daq.acquisition.effects import Note
from daq.acquisition.links import Links
from daq.acquisition.recorder import Disk, DiskState, Recorder
from daq.drivers.calibrated import calibrations_of
from daq.drivers.devices import channels_of, make_pipelines
from daq.log.file import ReservedName
from daq.log.outcome import ENDED, tripping
from daq.transports import HostClock
from daq.version import DECODER, software_version
from rig_configs.schema import Rig


class SessionLog:
    """Recordings of one session.

    Args:
        rig: the rig file.
        clock: the host clock.
        identities: identities of the devices; completed with what the pipelines learn.
        core: core of the acquisition.
        links: links of the devices.
        disk: opens the disk's file and reports its room.

    Attributes:
        recorder: writer of the open log; None without one.
        path: path of the newest recording; None before the first.
        changes: lock that excludes ticks between the last events of a log and its end.
    """

    def __init__(
        self,
        rig: Rig,
        clock: HostClock,
        identities: dict[str, dict[str, Any]],
        core: Core,
        links: Links,
        disk: Disk,
    ) -> None:
        self.recorder: Recorder | None = None
        self.path: Path | None = None
        self.changes: threading.RLock = threading.RLock()
        self._rig, self._clock, self._identities, self._disk = rig, clock, identities, disk
        self._core, self._links = core, links
        self._channels = tuple(channels_of(rig.devices).values())

    def disk(self) -> DiskState | None:
        """Return the state of the disk, or None if no log is recorded."""
        recorder = self.recorder
        return None if recorder is None else recorder.state()

    def losses(self) -> dict[str, dict[str, int]]:
        """Return the losses of every device since the start of the log, including silences that have not ended."""
        return self._core.losses(self._clock.now_ns())

    def begin(self, path: Path | ReservedName, metadata: Mapping[str, str], before_s: float) -> None:
        """Begin a log; see `daq.acquisition.session.Session.start_recording`. No other log may be open."""
        seeds = self._learned()
        facts = {
            "rig": self._rig.name,
            "software": software_version(),
            "decoder": str(DECODER),
            "started": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(self._clock.now_ns() * 1e-9)),
            **calibrations_of(self._rig.devices),
            **metadata,
        }
        attachments = {
            "rig.json": self._rig.snapshot_json(),
            "identities.json": json.dumps(self._identities).encode(),
            "roles.json": self._rig.roles_json(),
        }
        if seeds:
            attachments["clocks.json"] = json.dumps(seeds).encode()
        devices = tuple(self._rig.devices)
        self.path = path if isinstance(path, Path) else path.path
        recorder = Recorder(path, self._clock, facts, attachments, devices, self._channels, self._disk)
        self.renew_pipelines(recorder, before_s, seeds)

    def _learned(self) -> dict[str, dict[str, Any]]:
        """Add to the identities what the pipelines have learnt from the bytes, for the next log.

        Returns:
            States of the device clocks, so that the clock maps of the next log start with them.
        """
        seeds: dict[str, dict[str, Any]] = {}
        for name, pipeline in self._core.pipelines.items():
            with self._links.unread(name):
                status = pipeline.status
            if status.learned:
                self._identities.setdefault(name, {}).update(status.learned)
            if status.clock_seed is not None:
                seeds[name] = asdict(status.clock_seed)
        return seeds

    def renew_pipelines(
        self,
        recorder: Recorder | None,
        before_s: float = 0.0,
        seeds: Mapping[str, Mapping[str, Any]] | None = None,
    ) -> None:
        """Give every device a new pipeline, at a boundary between two reads.

        Args:
            recorder: writer of the log that begins; None without one.
            before_s: length of the pre-trigger, s.
            seeds: states of the device clocks.
        """
        pipelines = make_pipelines(self._rig.devices, self._identities, seeds=seeds)
        with self.changes, self._links.between_reads():
            self.recorder = recorder
            for past in self._core.begin(pipelines, self._clock.now_ns(), before_s):
                if recorder is not None:
                    recorder.add(past)

    def end(self, reason: Callable[[], str], summary: Mapping[str, Any]) -> Path:
        """End the log and return its path.

        Args:
            reason: called after the last events are written; returns the reason of the end.
            summary: further facts for the log's summary, which may replace the reason.
        """
        recorder = self.recorder
        assert recorder is not None
        with self.changes, self._links.between_reads():
            now_ns = self._clock.now_ns()
            for kept in self._core.finish(now_ns):
                recorder.add(kept)
            facts, events = self._core.end(now_ns)
            for event in events:
                recorder.add(Note(event, now_ns))
            self.recorder = None
        facts = {**facts, ENDED: reason(), **summary}
        reasons = [(reason.interlock, reason.text) for reason in self._core.trips.reasons]
        return recorder.close({**facts, **tripping(facts[ENDED], reasons)})
