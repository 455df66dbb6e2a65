"""How late bytes are stamped, and how late the rotor is stopped: in real time, on ptys.

    python -m benchmarks.latency [--rig virtual] [--seconds 60] [--trips 100]

The simulated rig is in a process of its own. Receive latency: from the last byte of a read leaving the far end to the
host's time that the log gives that read. Interlock latency: from the first sample beyond `limits.amplitude_m` leaving
the far end to the stop at the drive: its command on the wire and the far end's next look at it are in it, the rotor's
own braking is not. Each trip is a session of its own with a rotor that turns at 200 rpm, and a pull of 1.08 times the
limit at a random moment.
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
import tempfile
import time
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from daq.acquisition.session import Session
from daq.errors import AcquisitionError
from daq.log import open_log
from daq.transports import HostClock
from daq.virtual_rig.control import OperatorLine
from daq.virtual_rig.run import VirtualRig
from rig_configs import load_rig
from rig_configs.schema import Rig

_RPM, _PULL = 200.0, 1.08  # within the sensors' range: else they would be blind
_MARK_BYTES = 48


class _Timed(VirtualRig):
    """A virtual rig that records when its bytes left, the column was too far out and the drive was stopped."""

    def __init__(self, rig: Rig, reports: Connection) -> None:
        super().__init__(rig, link="pty")
        self._reports = reports
        self._limit_m = rig.limits.amplitude_m
        self.out: dict[str, list[tuple[int, bytes]]] = {name: [] for name in self.wires}
        self._far_ns: int | None = None
        for name, wire in self.wires.items():
            wire.send = self._timed(name, wire.send)

    def _timed(self, name, send):
        def timed(data: bytes) -> None:
            send(data)
            if data:
                self.out[name].append((time.monotonic_ns(), data))

        return timed

    def step(self) -> None:
        """See VirtualRig."""
        super().step()
        motion = self.rig.motion
        turned = motion.target_rad_s != 0.0 and not motion.braking
        if self._far_ns is None and turned and float(np.hypot(*motion.displacement_m)) > self._limit_m:
            self._far_ns = time.monotonic_ns()
        elif self._far_ns is not None and not turned:
            self._reports.send((time.monotonic_ns() - self._far_ns) * 1e-6)
            self._far_ns = None


def _serve(rig: Rig, reports: Connection, path: Path) -> None:
    virtual = _Timed(rig, reports)
    reports.send((virtual.ports(), virtual.control.port, virtual.token))
    virtual.run()
    virtual.close()
    for name, sent in virtual.out.items():
        np.savez(
            path / name,
            ns=[ns for ns, _ in sent],
            size=[len(data) for _, data in sent],
            data=np.frombuffer(b"".join(data for _, data in sent), np.uint8),
        )


def receive_ms(log: Path, folder: Path, utc_ns: int) -> dict[str, np.ndarray]:
    """Of every read of a log, by device: how long after its last byte had left it is stamped, ms."""
    out = {}
    with open_log(log) as found:
        reads: dict[str, list[tuple[int, bytes]]] = {name: [] for name in found.devices}
        for name, chunk in found.raw_in_order():
            if chunk.direction == 0:
                reads[name].append((chunk.host_ns, chunk.data))
    for name, got in reads.items():
        with np.load(folder / f"{name}.npz") as kept:
            sent, ends, ns = kept["data"].tobytes(), np.cumsum(kept["size"]), kept["ns"]
        whole = b"".join(data for _, data in got)
        begin = sent.find(whole[:_MARK_BYTES])
        while begin >= 0 and sent[begin : begin + len(whole)] != whole:
            begin = sent.find(whole[:_MARK_BYTES], begin + 1)
        if begin < 0:
            raise SystemExit(f"{name}: the log's bytes are not those that were sent")
        last = begin + np.cumsum([len(data) for _, data in got]) - 1
        left = ns[np.searchsorted(ends, last, side="right")]
        out[name] = (np.array([host_ns for host_ns, _ in got]) - utc_ns - left) * 1e-6
    return out


def main() -> int:
    """Exit code 1 when a trip came to nothing."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rig", default="virtual")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--trips", type=int, default=100)
    given = parser.parse_args()
    rig, dice = load_rig(given.rig), np.random.default_rng(7)
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    with tempfile.TemporaryDirectory() as folder:
        process = context.Process(target=_serve, args=(rig, theirs, Path(folder)), daemon=True)
        process.start()
        ports, port, token = ours.recv()
        line = OperatorLine(port, token)
        here = load_rig(given.rig, settings=[f'devices.{name}.port="{at}"' for name, at in ports.items()])
        clock = HostClock()
        utc_ns = clock.now_ns() - time.monotonic_ns()
        log = Path(folder, "a.mcap")
        with Session(here, clock) as session:
            session.start_recording(log, {})
            end = clock.now_s() + given.seconds
            while clock.now_s() < end:
                session.check()
                clock.wait(0.1)
            session.stop_recording({})
        stops: list[float] = []
        for _ in range(given.trips):
            line.ask("pluck", x_mm=0.0, y_mm=0.0, hold_s=0.2)  # the column still rings from the last one
            clock.wait(0.3)
            try:
                with Session(here, HostClock()) as session:
                    session.drive.enable()
                    session.drive.set_ramp(600.0)
                    session.drive.set_speed(_RPM)
                    clock.wait(1.0 + dice.uniform(0.0, 0.3))
                    line.ask("pluck", x_mm=1e3 * _PULL * rig.limits.amplitude_m, y_mm=0.0, hold_s=0.2)
                    session.wait_for(lambda: False, 3.0, "the trip")
            except AcquisitionError as ended:
                if not ours.poll(1.0):
                    print(f"no stop: {ended}")
                    continue
                stops.append(ours.recv())
        line.ask("quit")
        process.join()
        for name, late in receive_ms(log, Path(folder), utc_ns).items():
            print(f"{name:10} {len(late)} reads: stamped {_words(late)} after their last byte left")
    if stops:
        print(f"{len(stops)} of {given.trips} trips: stopped {_words(np.array(stops))} after the first sample")
    return 0 if len(stops) == given.trips else 1


def _words(late_ms: np.ndarray) -> str:
    middle, most = np.percentile(late_ms, [50, 99])
    return f"p50 {middle:.2f}, p99 {most:.2f}, max {late_ms.max():.2f} ms"


if __name__ == "__main__":
    sys.exit(main())
