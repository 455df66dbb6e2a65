"""A bench whose bytes are recorded as in a session, to compare its trips with those of a replay."""

from __future__ import annotations

from pathlib import Path

from daq.drivers.canopen import cia301
from daq.drivers.devices import make_pipelines
from daq.items import RX, TX, Batch, DeviceEvent
from daq.log.file import LogFile
from daq.transports.can_frames import CanFrame, encode
from rig_configs import load_rig
from tests.daq.far_ends import START_NS, Bench


class RecordedBench(Bench):
    """See Bench.

    Args:
        path: path of the log.
        settings: settings for the virtual rig's file.
        test: name of the test in the log.
        facts: further facts of the run.
        listened: True: nothing sent to the drive is in the log, as in a session that only receives.
        raw: True: bytes are recorded; False: samples and events only.
    """

    def __init__(
        self,
        path: Path,
        *settings: str,
        test: str = "record",
        facts: dict[str, str] | None = None,
        listened: bool = False,
        raw: bool = True,
    ) -> None:
        self._listened, self._raw = listened, raw
        rig = load_rig("virtual", settings=["virtual.seed=5", *settings])
        self._decoders = make_pipelines(rig.devices, {})
        attachments = {"rig.json": rig.snapshot_json(), "roles.json": rig.roles_json()}
        known = {"test": test, "rig": rig.name, **(facts or {})}
        self.log = LogFile(path, known, attachments, tuple(rig.devices) if raw else (), START_NS)
        super().__init__(*settings)

    def _hear(self, name: str, data: bytes) -> None:
        if data and name not in self.muted:
            self._keep(name, RX, data)
        super()._hear(name, data)

    def _to_drive(self, identifier: int, data: bytes) -> None:
        self._keep("drive", TX, encode(CanFrame(identifier, data)))
        super()._to_drive(identifier, data)

    def _keep(self, name: str, direction: int, data: bytes) -> None:
        if direction == TX and self._listened:
            return
        if self._raw:
            self.log.raw(name, direction, data, self.now_ns)
        for item in self._decoders[name].feed(direction, data, self.now_ns):
            if isinstance(item, Batch):
                self.log.batch(item, self.now_ns)
            else:
                self.log.event(item, self.now_ns)

    def beat(self) -> None:
        """The host's heartbeat: an open session sends bytes to its drive continuously."""
        self._keep("drive", TX, encode(CanFrame(cia301.cob_heartbeat(1), b"\x05")))

    def note(self, event: DeviceEvent) -> None:
        """Write the stop and the summary of a session."""
        self.log.event(event, self.now_ns)

    def finish(self, ended: str = "duration") -> Path:
        """The finished log."""
        self.log.flush()
        return self.log.finish({"losses": {}, "ended": ended})
