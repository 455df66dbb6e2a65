"""An open rig: one reader thread per device, fresh pipelines per log, the last seconds of every channel at hand."""

from __future__ import annotations

import json
import queue
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq import channels, lasers
from daq.drive import DriveControl
from daq.errors import DeviceError, LinkLost, ProcedureError
from daq.protocols import rotorlink
from daq.recorder import Recorder
from daq.streams import RX, TX, Batch, DrivePipeline, Event, Pipeline, make_pipelines
from daq.transports import HostClock, Link, open_link
from rig_configs.schema import Rig

_KEEP_S = 90.0
_HEALTH_S = 1.0


class Recent:
    """The last seconds of every channel, for procedures and interlocks."""

    def __init__(self, keep_s: float) -> None:
        self._keep_ns = int(keep_s * 1e9)
        self._batches: dict[str, deque[Batch]] = {topic: deque() for topic in channels.CHANNELS}
        self._lock = threading.Lock()

    def add(self, batch: Batch) -> None:
        """Append one batch and forget what is too old."""
        with self._lock:
            kept = self._batches[batch.channel.topic]
            kept.append(batch)
            oldest = int(batch.time_ns[-1]) - self._keep_ns
            while len(kept) > 1 and int(kept[0].time_ns[-1]) < oldest:
                kept.popleft()

    def last(self, topic: str, fields: tuple[str, ...], since_ns: int = 0) -> tuple[NDArray[np.int64], list[Any]]:
        """Times (ns) and columns of a channel since an instant; empty arrays when there is nothing."""
        with self._lock:
            kept = [b for b in self._batches[topic] if int(b.time_ns[-1]) >= since_ns]
        if not kept:
            return np.empty(0, np.int64), [np.empty(0) for _ in fields]
        time_ns = np.concatenate([b.time_ns for b in kept])
        take = time_ns >= since_ns
        return time_ns[take], [np.concatenate([b.columns[f] for b in kept])[take] for f in fields]

    def clear(self) -> None:
        """Forget everything (the clock maps begin anew with each log)."""
        with self._lock:
            for kept in self._batches.values():
                kept.clear()


class _Device:
    """One link with its reader thread."""

    def __init__(self, name: str, link: Link, pipeline: Pipeline) -> None:
        self.name, self.link, self.pipeline = name, link, pipeline
        self.lock = threading.Lock()  # rx and tx reach pipeline and log in one order
        self.replies: queue.Queue[str] = queue.Queue()
        self.bytes_in = 0
        self.thread: threading.Thread | None = None


class Session:
    """All devices of a rig, open and streaming.

    Args:
        rig: the rig file.
        clock: the host clock.
    Raises (from `open`):
        LinkLost: a port cannot be opened.
        DeviceError: a device does not answer as it should.
    """

    def __init__(self, rig: Rig, clock: HostClock) -> None:
        self.rig, self.clock = rig, clock
        self.recent = Recent(_KEEP_S)
        self.identities: dict[str, dict[str, Any]] = {}
        self.trouble: Exception | None = None
        self.drive: DriveControl
        self._devices: dict[str, _Device] = {}
        self._recorder: Recorder | None = None
        self._events: queue.Queue[Event] = queue.Queue()
        self._watchers: list[Callable[[Batch], None]] = [self._guard_amplitude]
        self._command_seq = 0
        self._closing = False
        self._tripped = False
        self._stack = ExitStack()

    def open(self) -> Session:
        """Open every link, identify the devices, start their streams."""
        d = self.rig.devices
        pipelines = make_pipelines(d, {})
        ports = {
            "laser_x": (d.laser_x.port, d.laser_x.baud, None),
            "laser_y": (d.laser_y.port, d.laser_y.baud, None),
            "encoder": (d.encoder.port, d.encoder.baud, None),
            "drive": (d.drive.port, 115_200, d.drive.bitrate),
        }
        try:
            for name, (port, baud, bitrate) in ports.items():
                link = open_link(port, baud, bitrate)
                device = _Device(name, link, pipelines[name])
                self._devices[name] = device
            self.drive = DriveControl(d.drive, lambda data: self.send("drive", data), self.clock)
            for device in self._devices.values():
                device.thread = threading.Thread(target=self._read, args=(device,), name=device.name, daemon=True)
                device.thread.start()
            for name, config in (("laser_x", d.laser_x), ("laser_y", d.laser_y)):
                self.identities[name] = lasers.configure(
                    name, config, lambda data, n=name: self.send(n, data), self._devices[name].replies
                )
            self.identities["encoder"] = {"driver": d.encoder.driver, "port": d.encoder.port}
            self.drive.start()
            self.identities["drive"] = {"driver": d.drive.driver, "node_id": d.drive.node_id}
            self.wait_for(self._all_alive, 3.0, "every device to send samples")
            threading.Thread(target=self._report_health, name="health", daemon=True).start()
        except BaseException:
            self.close()
            raise
        return self

    def __enter__(self) -> Session:
        return self.open()

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop drive and streams, close every link."""
        if self._recorder is not None:
            self.stop_recording({"ended": "session closed"})
        if not self._closing and hasattr(self, "drive"):
            for step in (self.drive.stop, lambda: self.send("laser_x", b"OUTPUT NONE\n"),
                         lambda: self.send("laser_y", b"OUTPUT NONE\n")):  # fmt: skip
                try:
                    step()
                except (LinkLost, DeviceError):
                    continue
        self._closing = True
        for device in self._devices.values():
            if device.thread is not None:
                device.thread.join(timeout=2.0)
            device.link.close()

    def _all_alive(self) -> bool:
        return all(len(self.recent.last(t, ())[0]) for t in ("laser/x", "laser/y", "pendulums", "motor"))

    # --- bytes -------------------------------------------------------------------------------------------------

    def _read(self, device: _Device) -> None:
        while not self._closing:
            try:
                data = device.link.read(0.1)
            except LinkLost as error:
                if not self._closing:
                    self._fail(error)
                return
            if data:
                host_ns = self.clock.now_ns()
                try:
                    with device.lock:
                        device.bytes_in += len(data)
                        self._take(device, RX, data, host_ns)
                except Exception as error:  # a decoder's bug must stop the rig, not one thread
                    self._fail(error)
                    return

    def send(self, name: str, data: bytes) -> None:
        """Write to a device; the bytes go into the log as they go out.

        Raises:
            LinkLost: the device is gone.
        """
        device = self._devices[name]
        with device.lock:
            self._take(device, TX, data, self.clock.now_ns())
            device.link.write(data)

    def _take(self, device: _Device, direction: int, data: bytes, host_ns: int) -> None:
        recorder = self._recorder
        if recorder is not None:
            recorder.raw(device.name, direction, data, host_ns)
        found = device.pipeline.feed(direction, data, host_ns)
        if direction == RX and isinstance(device.pipeline, DrivePipeline) and device.pipeline.frames:
            self.drive.notice(device.pipeline.frames)
        for item in found:
            if isinstance(item, Batch):
                if recorder is not None:
                    recorder.batch(item, host_ns)
                self.recent.add(item)
                for watch in self._watchers:
                    watch(item)
            else:
                if recorder is not None:
                    recorder.event(item, host_ns)
                if item.kind == "reply":
                    device.replies.put(item.text)
                else:
                    self._events.put(item)

    def _fail(self, error: Exception) -> None:
        """Remember the first trouble and stop the rotor; whoever waits is told."""
        if self.trouble is None:
            self.trouble = error
        try:
            self.drive.quick_stop()
        except Exception:
            return  # the drive's own watchdog stops it when our heartbeat ends

    def _guard_amplitude(self, batch: Batch) -> None:
        if batch.channel.topic not in ("laser/x", "laser/y") or self._tripped:
            return
        largest = np.nanmax(np.abs(batch.columns["displacement_m"]), initial=0.0)
        if largest > self.rig.limits.amplitude_m and self.drive.actual_rpm != 0:
            self._tripped = True
            self._fail(
                ProcedureError(
                    f"{batch.channel.topic}: {largest * 1e3:.1f} mm is beyond limits.amplitude_m = "
                    f"{self.rig.limits.amplitude_m * 1e3:g} mm; the rotor was stopped"
                )
            )

    def _report_health(self) -> None:
        while not self._closing:
            time.sleep(_HEALTH_S / self.clock.rate)
            recorder = self._recorder
            if recorder is not None:
                recorder.health({"kind": "health", "device": "host", "text": "", "losses": self.losses(),
                                 "stalled": recorder.stalled,
                                 "bytes": {n: d.bytes_in for n, d in self._devices.items()}})  # fmt: skip
                if recorder.error is not None:
                    self._fail(recorder.error)

    # --- recording ---------------------------------------------------------------------------------------------

    def losses(self) -> dict[str, dict[str, int]]:
        """Counted losses of every device since the recording began."""
        return {name: dict(device.pipeline.losses) for name, device in self._devices.items()}

    def start_recording(self, path: Path, metadata: Mapping[str, str]) -> None:
        """Begin a log. Every device gets a fresh pipeline, so that the log alone decodes to the same samples."""
        facts = {
            "rig": self.rig.name,
            "software": software_version(),
            "clock_rate": repr(self.clock.rate),
            "started": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
            **metadata,
        }
        attachments = {
            "rig.json": self.rig.snapshot_json(),
            "identities.json": json.dumps(self.identities).encode(),
        }
        recorder = Recorder(path, self.clock, facts, attachments, tuple(self._devices))
        pipelines = make_pipelines(self.rig.devices, self.identities)
        with ExitStack() as stack:
            for device in self._devices.values():
                stack.enter_context(device.lock)
            self.recent.clear()
            for name, device in self._devices.items():
                device.pipeline = pipelines[name]
            self._recorder = recorder

    def stop_recording(self, summary: Mapping[str, Any]) -> Path:
        """End the log; losses go into its summary."""
        recorder = self._recorder
        assert recorder is not None
        with ExitStack() as stack:
            for device in self._devices.values():
                stack.enter_context(device.lock)
            self._recorder = None
        return recorder.close({"losses": self.losses(), "stalled": recorder.stalled, **summary})

    # --- waiting and commands ----------------------------------------------------------------------------------

    def check(self) -> None:
        """Raise the first trouble a background thread met."""
        if self.trouble is not None:
            raise self.trouble

    def wait_for(self, condition: Callable[[], bool], wall_s: float, what: str) -> None:
        """Wait until a condition holds, at most so long on the wall's clock.

        Raises:
            DeviceError: it does not come true in time.
        """
        deadline = time.monotonic() + wall_s
        while not condition():
            self.check()
            if time.monotonic() > deadline:
                raise DeviceError(f"waited {wall_s:g} s for {what}; it did not come")
            time.sleep(0.003)

    def command_node(self, action: str) -> None:
        """Send a command to the on-rotor node until it is acknowledged; a lost frame is repeated with its seq.

        Raises:
            DeviceError: refused (the message says why) or never acknowledged.
        """
        self._command_seq = (self._command_seq + 1) & 0x7FFF
        seq = self._command_seq
        frame = rotorlink.wire(rotorlink.Command(1, seq, rotorlink.ACTIONS[action]).pack())
        for _ in range(20):
            self.send("encoder", frame)
            deadline = time.monotonic() + 0.15
            while time.monotonic() < deadline:
                self.check()
                try:
                    event = self._events.get(timeout=0.02)
                except queue.Empty:
                    continue
                if event.kind == "acknowledge" and event.facts["command_seq"] == seq:
                    if event.facts["result"] in (0, 4):  # 4: it already is so
                        return
                    raise DeviceError(f"encoder node: {action!r} refused: {event.text}")
        raise DeviceError(f"encoder node: {action!r} was not acknowledged after 20 tries. Is the radio in reach?")


def software_version() -> str:
    """Version of the installed package."""
    try:
        return version("pendulum-balancer-rig")
    except PackageNotFoundError:
        return "unknown"
