"""An open rig: one reader thread per device, fresh pipelines per log, the last seconds of every channel at hand."""

from __future__ import annotations

import contextlib
import json
import queue
import secrets
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack, nullcontext
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from daq import lasers
from daq.drive import DriveControl
from daq.drive_stream import DrivePipeline
from daq.errors import DeviceError, LinkLost, ProcedureError
from daq.laser_blocks import compile_loop
from daq.log.file import ReservedName
from daq.node_stream import NodePipeline
from daq.protocols import optoncdt, rotorlink
from daq.rate_watch import RateWatches
from daq.reader import DeviceReader, keep_heap_whole
from daq.recent import Recent
from daq.recorder import DiskState, Recorder
from daq.stream_items import RX, TX, Batch, Event
from daq.streams import make_pipelines
from daq.transports import HostClock, open_link
from daq.version import software_version
from rig_configs.schema import Rig

_KEEP_S = 90.0
_ALIVE_S = 3.0  # wall seconds
_HEALTH_S = 1.0
_WATCH_S = 0.25  # wall seconds between two looks for silent devices
_SILENCE_S = 2.0  # wall seconds
_OUT_OF_RANGE_SAMPLES = 5  # in one read; fewer may be a flash of light


DEVICE_OF = {"laser/x": "laser_x", "laser/y": "laser_y", "pendulums": "encoder", "motor": "drive"}
"""Channels that every open rig fills all the time, and whose they are."""


class Session:
    """All devices of a rig, open and streaming.

    Args:
        rig: the rig file.
        clock: the host clock.
        identities: what the devices are known to be, for a session that only listens; `open` asks them itself.
    Raises (from `open` and `listen`):
        LinkLost: a port cannot be opened.
        DeviceError: a device does not answer as it should.
    """

    def __init__(self, rig: Rig, clock: HostClock, identities: Mapping[str, Mapping[str, Any]] | None = None) -> None:
        self.rig, self.clock = rig, clock
        self.recent = Recent(_KEEP_S)
        self.identities: dict[str, dict[str, Any]] = {name: dict(known) for name, known in (identities or {}).items()}
        self.rates = RateWatches(rig.devices)
        self.observers: list[Callable[[Event], None]] = []  # told of every event
        self.trouble: Exception | None = None
        self.lenient = False  # whether a device that is not what the rig file says is only looked at, as by `rig check`
        self._drive: DriveControl | None = None
        self._devices: dict[str, DeviceReader] = {}
        self._recorder: Recorder | None = None
        self._acknowledges: queue.Queue[Event] = queue.Queue()
        self._watchers: list[Callable[[Batch], None]] = [self._guard_amplitude]
        # The node remembers the seq of past commands, also those of an earlier session, and acts once on each.
        self._command_seq = secrets.randbelow(0x8000)
        self._closing = False
        self._opening = False
        self._tripped = False
        self._disk_slow = False

    def open(self) -> Session:
        """Open every link, identify the devices, start their streams."""
        d, self._opening = self.rig.devices, True
        try:
            self._open_links()
            self._drive = DriveControl(d.drive, lambda data: self.send("drive", data), self.clock)
            self._start_readers()
            for name, config in (("laser_x", d.laser_x), ("laser_y", d.laser_y)):
                device = self._devices[name]
                self.identities[name] = lasers.configure(
                    name, config, lambda data, n=name: self.send(n, data), device, partial(self._forget, device)
                )
            self.identities["encoder"] = {"driver": d.encoder.driver, "port": d.encoder.port}
            self.drive.start()
            self.identities["drive"] = {"driver": d.drive.driver, "node_id": d.drive.node_id}
            self._wait_alive("every device to send samples")
            self._begin_anew(None)  # what waited in the ports' buffers was late and would mislead the clock maps
            self._opening = False  # from now on a restart is one
            self._wait_alive("every device to go on sending samples")
            self._start_watching()
        except BaseException:
            self.close()
            raise
        return self

    def listen(self, path: Path | ReservedName, metadata: Mapping[str, str]) -> Session:
        """Open every link without a word and record from the first byte; whoever runs the rig is someone else.

        Nothing is configured and nothing is turned; a device may be silent. Identities are those given to the session,
        else the rig file's word counts.
        """
        try:
            self._open_links()
            self.start_recording(path, metadata)
            self._start_readers()
            self._start_watching()
        except BaseException:
            self.close()
            raise
        return self

    def _open_links(self) -> None:
        keep_heap_whole()
        compile_loop()
        d = self.rig.devices
        ports = {
            "laser_x": (d.laser_x.port, d.laser_x.baud, None),
            "laser_y": (d.laser_y.port, d.laser_y.baud, None),
            "encoder": (d.encoder.port, d.encoder.baud, None),
            "drive": (d.drive.port, 115_200, d.drive.bitrate),
        }
        pipelines = make_pipelines(d, {})
        for name, (port, baud, bitrate) in ports.items():
            self._devices[name] = DeviceReader(name, open_link(port, baud, bitrate), pipelines[name], self.clock)

    def _start_readers(self) -> None:
        for device in self._devices.values():
            device.start(partial(self._take, device, RX), self._fail)

    def _start_watching(self) -> None:
        threading.Thread(target=self._watch, name="health", daemon=True).start()

    def __enter__(self) -> Session:
        return self if self._devices else self.open()

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop drive and streams, close every link."""
        if self._closing:
            return
        try:
            self._stop_devices()
        finally:
            try:
                if self._recorder is not None:
                    self.stop_recording({"ended": str(self.trouble or "session closed")})
            finally:
                self._closing = True
                for device in self._devices.values():
                    device.stop()

    def _stop_devices(self) -> None:
        """Rotor to rest, streams off; a device that is gone does not keep the others from being stopped."""
        if self._drive is None:
            return
        for step in (
            self.drive.stop,
            lambda: self.send("laser_x", b"OUTPUT NONE\n"),
            lambda: self.send("laser_y", b"OUTPUT NONE\n"),
        ):
            with contextlib.suppress(LinkLost, DeviceError):
                step()

    @property
    def drive(self) -> DriveControl:
        """The motor drive of an open session."""
        assert self._drive is not None, "the session is not open"
        return self._drive

    def _silent(self) -> list[str]:
        """Devices of which no sample has come."""
        return [device for topic, device in DEVICE_OF.items() if not len(self.recent.last(topic, ())[0])]

    def _wait_alive(self, what: str) -> None:
        """Wait for samples of every device; of those that give none, say what came instead."""
        try:
            self.wait_for(lambda: not self._silent(), _ALIVE_S, what)
        except DeviceError as error:
            silent = self._silent()
            if self.trouble is not None or not silent:
                raise
            raise DeviceError(f"{error}: {'; '.join(map(self._what_came, silent))}") from error

    def _what_came(self, name: str) -> str:
        device = self._devices[name]
        lost = ", ".join(f"{n} {kind.replace('_', ' ')}" for kind, n in device.pipeline.losses.items() if n)
        came = f"{device.bytes_in} bytes came, none of them a sample" if device.bytes_in else "silent"
        return f"{name}: {came}{f' ({lost})' if lost else ''}. Look at its power, its settings and the rig file"

    def _forget(self, device: DeviceReader) -> None:
        """A fresh pipeline for a device whose line has just run dry: what it sent before was told to someone else."""
        with device.lock:
            device.pipeline = make_pipelines(self.rig.devices, self.identities)[device.name]

    # --- bytes -------------------------------------------------------------------------------------------------

    def send(self, name: str, data: bytes) -> None:
        """Write to a device; the bytes go into the log as they go out.

        Raises:
            LinkLost: the device is gone.
        """
        device = self._devices[name]
        with device.lock:
            self._take(device, TX, data, self.clock.now_ns())
            device.link.write(data)

    def _take(self, device: DeviceReader, direction: int, data: bytes, host_ns: int) -> None:
        recorder = self._recorder
        with nullcontext() if recorder is None else recorder.together():
            if recorder is not None and not recorder.raw(device.name, direction, data, host_ns):
                recorder = None  # the run has ended; interlocks go on
            found = device.pipeline.feed(direction, data, host_ns)
            found += self.rates.feed(found, host_ns)
            if recorder is not None:
                for item in found:
                    recorder.batch(item, host_ns) if isinstance(item, Batch) else recorder.event(item, host_ns)
        for item in found:
            if isinstance(item, Batch):
                self.recent.add(item)
                for watch in self._watchers:
                    watch(item)
                continue
            for observe in self.observers:
                observe(item)
            if item.kind == "reply":
                device.replies.put(item.text)
            elif item.kind == "acknowledge":
                self._acknowledges.put(item)
            elif self.trouble is None and self._ends_the_run(item.kind):
                self.trouble = DeviceError(f"{item.device}: {item.text}")
        if self._drive is not None and isinstance(device.pipeline, DrivePipeline) and direction == RX:
            self.drive.notice(device.pipeline.frames)

    def _ends_the_run(self, kind: str) -> bool:
        return (kind == "fault" and not self.lenient) or (kind == "restart" and not self._opening)

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
        if self._drive is None or self._drive.actual_rpm == 0:
            return
        largest = np.nanmax(np.abs(batch.columns["displacement_m"]), initial=0.0)
        codes = batch.columns["code"]
        beyond_range = (
            int(codes.max()) > optoncdt.CODE_MAX
            and np.count_nonzero(np.isin(codes, optoncdt.OUT_OF_RANGE)) >= _OUT_OF_RANGE_SAMPLES
        )
        if largest > self.rig.limits.amplitude_m or beyond_range:
            self._tripped = True
            seen = "out of the sensor's range" if beyond_range else f"{largest * 1e3:.1f} mm"
            self._fail(
                ProcedureError(
                    f"{batch.channel.topic}: {seen}, limits.amplitude_m is "
                    f"{self.rig.limits.amplitude_m * 1e3:g} mm; the rotor was stopped"
                )
            )

    def _watch(self) -> None:
        try:
            self._report_health()
        except Exception as error:  # nobody would look at disk and silence any more
            self._fail(error)

    def _report_health(self) -> None:
        due = time.monotonic()
        silent: set[str] = set()
        while not self._closing:
            time.sleep(_WATCH_S)
            now = time.monotonic()
            still = {n for n, d in self._devices.items() if now - d.heard_s > _SILENCE_S}
            for name in still & silent if self._drive is not None else ():  # seen twice: no host that was asleep
                self._fail(
                    DeviceError(f"{name}: silent for {_SILENCE_S:g} s. Look at its cable, its power, its battery")
                )
            silent = still
            recorder = self._recorder
            if recorder is not None:
                self._look_at_disk(recorder)
            if now >= due and recorder is not None:
                due = now + _HEALTH_S / self.clock.rate
                facts = {"losses": self.losses(), "disk": recorder.state().facts()}
                facts["bytes"] = {n: d.bytes_in for n, d in self._devices.items()}
                recorder.health({"kind": "health", "device": "host", "text": "", **facts})

    def _look_at_disk(self, recorder: Recorder) -> None:
        """Say that the disk is slow while nothing is lost yet; end the run when it has to be."""
        state = recorder.look()
        if state.slow != self._disk_slow:
            self._disk_slow = state.slow
            text = (
                f"the disk is slow: {state.backlog_bytes / 1e6:.1f} MB wait, the oldest for {state.unsynced_s:.1f} s"
                if state.slow
                else "the disk keeps up again"
            )
            recorder.event(Event("disk", "host", text, state.facts()), self.clock.now_ns())
        if recorder.trouble is not None:
            self._fail(recorder.trouble)

    @property
    def node(self) -> NodePipeline:
        """What decodes the encoder node, with the node's newest word of itself."""
        pipeline = self._devices["encoder"].pipeline
        assert isinstance(pipeline, NodePipeline)
        return pipeline

    # --- recording ---------------------------------------------------------------------------------------------

    @property
    def bytes_in(self) -> int:
        """Bytes from all devices so far."""
        return sum(device.bytes_in for device in self._devices.values())

    @property
    def silent_s(self) -> float:
        """How long no device has sent anything, wall s."""
        return time.monotonic() - max(device.heard_s for device in self._devices.values())

    def disk(self) -> DiskState | None:
        """How the disk keeps up with the recording; None when nothing is recorded."""
        recorder = self._recorder
        return None if recorder is None else recorder.state()

    def losses(self) -> dict[str, dict[str, int]]:
        """Counted losses of every device since the recording began."""
        return {name: dict(device.pipeline.losses) for name, device in self._devices.items()}

    def start_recording(self, path: Path | ReservedName, metadata: Mapping[str, str]) -> None:
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
        self._begin_anew(recorder)

    def _begin_anew(self, recorder: Recorder | None) -> None:
        """Give every device a fresh pipeline, at a boundary between two reads."""
        pipelines = make_pipelines(self.rig.devices, self.identities)
        with ExitStack() as stack:
            for device in self._devices.values():
                stack.enter_context(device.lock)
            self.recent.clear()
            self.rates = RateWatches(self.rig.devices)
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
            losses, wrong_rates = self.losses(), self.rates.summary()
        return recorder.close({"losses": losses, **({"rates": wrong_rates} if wrong_rates else {}), **summary})

    # --- waiting and commands ----------------------------------------------------------------------------------

    def check(self) -> None:
        """Raise the first trouble a background thread met."""
        if self.trouble is not None:
            raise self.trouble
        if self._drive is not None and self._drive.dropped_out is not None:
            state, self._drive.dropped_out = self._drive.dropped_out, None
            raise ProcedureError(
                f"the drive went to {state} by itself. Look at the log's events and at the drive, then repeat the test"
            )

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
                    event = self._acknowledges.get(timeout=0.02)
                except queue.Empty:
                    continue
                if event.facts["command_seq"] == seq:
                    if event.facts["result"] in (0, 4):  # 4: it already is so
                        return
                    raise DeviceError(f"encoder node: {action!r} refused: {event.text}")
        raise DeviceError(f"encoder node: {action!r} was not acknowledged after 20 tries. Is the radio in reach?")
