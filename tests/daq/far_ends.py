"""The far ends of the virtual rig, the real pipelines and the interlocks in one thread on simulated time."""

from __future__ import annotations

from daq.acquisition.interlocks import Interlocks, Stop
from daq.acquisition.least_motion import LeastMotion
from daq.drivers.canopen import cia301
from daq.drivers.cia402 import wire as cia402
from daq.drivers.devices import make_pipelines
from daq.items import RX, Batch, DeviceEvent
from daq.transports.can_frames import CanFrame, encode, open_bus
from daq.virtual_rig.rig import SimulatedRig
from rig_configs import load_rig

START_NS = 1_700_000_000_000_000_000
STEP_S = 0.02


class Bench:
    """Far ends that are stepped by hand, with the stops of the interlocks.

    Attributes:
        stops: texts of the stops, each with the rig time, s.
        events: what belongs into a log.
    """

    def __init__(self, *settings: str) -> None:
        self.rig = load_rig("virtual", settings=["virtual.seed=5", *settings])
        self.far = SimulatedRig(self.rig)
        drive, node = self.far.far_ends["drive"], self.far.far_ends["encoder"]
        self.drive, self.node = drive, node
        self.pipelines = make_pipelines(self.rig.devices, {})
        self.interlocks = Interlocks(self.rig.limits, self.rig.roles, LeastMotion.of(self.rig), driving=True)
        self.now_s = self.far.motion.time_s
        self.stops: list[tuple[float, Stop]] = []
        self.events: list[DeviceEvent] = []
        self.muted: set[str] = set()
        self.drive.receive(
            open_bus(500_000), 0.0
        )  # the adapter was opened before: its answer and the boot-up message are old
        for laser in ("laser_x", "laser_y"):
            self.far.far_ends[laser].receive(b"OUTADD_RS422 COUNTER TIMESTAMP\nOUTPUT RS422\n", 0.0)
        self.drive._objects[cia301.PRODUCER_HEARTBEAT, 0] = (100, "<H")
        self._to_drive(0, bytes([1, self.rig.devices["drive"].node_id]))
        self.interlocks.begin(self.now_ns)
        self.pass_time(0.5)
        assert self.stops == []

    @property
    def now_ns(self) -> int:
        return START_NS + round(self.now_s * 1e9)

    def pass_time(self, seconds: float, until_stop: bool = False) -> float:
        """Let rig time pass; return the time until the first stop if `until_stop` is set, s."""
        begun = self.now_s
        while self.now_s < begun + seconds - 1e-9 and not (until_stop and self.stops):
            self._step()
        return self.now_s - begun

    def _step(self) -> None:
        self.now_s += STEP_S
        for name, far_end in self.far.far_ends.items():
            self._hear(name, far_end.step(self.far.motion.time_s))
        stretch = self.far.motion.advance(self.now_s)
        assert stretch is not None
        for name, far_end in self.far.far_ends.items():
            self._hear(name, far_end.sample(stretch))
        if round(self.now_s / STEP_S) % 5 == 0:
            self._heed(self.interlocks.tick(self.now_ns))

    def _hear(self, name: str, data: bytes) -> None:
        if not data or name in self.muted:
            return
        for item in self.pipelines[name].feed(RX, data, self.now_ns):
            if isinstance(item, Batch):
                self._heed(self.interlocks.feed(item, self.now_ns))
            else:
                self._heed(self.interlocks.happened(item))

    def _heed(self, found: list[DeviceEvent | Stop] | list[Stop]) -> None:
        for item in found:
            if isinstance(item, DeviceEvent):
                self.events.append(item)
            else:
                self.stops.append((self.now_s, item))

    def _to_drive(self, identifier: int, data: bytes) -> None:
        self._hear("drive", self.drive.receive(encode(CanFrame(identifier, data)), self.now_s))

    def turn(self, rpm: int, seconds: float | None = None) -> None:
        """Enable the drive, ramp to a speed and wait until it is there."""
        node = self.rig.devices["drive"].node_id
        self.interlocks.commanded(float(rpm))
        for word in (cia402.SHUTDOWN, cia402.SWITCH_ON, cia402.ENABLE_OPERATION):
            self._to_drive(cia301.cob_rpdo(1, node), cia402.VELOCITY.pack(word, rpm))
        for sub, value in ((0x6048, 400), (0x6049, 400)):
            self.drive._objects[sub, 1] = (value, "<I")
        self.drive._objects[0x6060, 0] = (2, "<b")
        self.pass_time(rpm / 400 + 1.0 if seconds is None else seconds)

    def quick_stop(self) -> None:
        """Stop the rotor as the session does."""
        self.interlocks.commanded(0.0)
        node = self.rig.devices["drive"].node_id
        self._to_drive(cia301.cob_rpdo(1, node), cia402.VELOCITY.pack(cia402.QUICK_STOP, 0))

    def fails(self, device: str, what: str, value: float = 1) -> None:
        """See FarEnd."""
        self.far.far_ends[device].fail(what, value)

    def why(self) -> str:
        """Text of the first stop."""
        return self.stops[0][1].text if self.stops else ""

    def __enter__(self) -> Bench:
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing is open: a bench has no wires."""
