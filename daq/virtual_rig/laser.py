"""A simulated optoNCDT sensor: answers ASCII commands, streams binary blocks on its own clock."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from daq.protocols import optoncdt
from daq.virtual_rig.motion import Trajectory
from rig_configs.schema import Laser

_ERROR_BEFORE, _ERROR_BEHIND, _ERROR_BAUD = 262077, 262078, 262075


class DeviceClock:
    """A clock with its own offset and rate: device = offset + (1 + drift) · rig time, s."""

    def __init__(self, offset_s: float, drift: float) -> None:
        self.offset_s, self.drift = offset_s, drift

    def device_s(self, time_s: NDArray[np.floating] | float) -> NDArray[np.floating] | float:
        """What the device's clock shows at a rig time."""
        return self.offset_s + (1 + self.drift) * time_s

    def rig_s(self, device_s: NDArray[np.floating]) -> NDArray[np.floating]:
        """Rig time at which the device's clock shows a value."""
        return (device_s - self.offset_s) / (1 + self.drift)


class SimulatedLaser:
    """One sensor on its serial line.

    Args:
        config: its table of the rig file.
        look: shape (2,), what it sees of x and y (axis angle and gain in it), dimensionless.
        offset_m: reading at rest against mid-range.
        noise_m: standard deviation of one sample.
    """

    def __init__(
        self,
        config: Laser,
        look: NDArray[np.floating],
        offset_m: float,
        noise_m: float,
        clock: DeviceClock,
        rng: np.random.Generator,
        serial: str,
    ) -> None:
        self._config, self._look, self._offset, self._noise = config, look, offset_m, noise_m
        self._clock, self._rng, self._serial = clock, rng, serial
        self._streaming = False
        self._echo = True
        self._extra: tuple[str, ...] = ()
        self._rate_hz = float(config.rate_Hz)
        self._next = 0  # number of the next sample on the device's clock
        self._counter = int(rng.integers(0, optoncdt.COUNTER_WRAP))
        self._line = bytearray()
        self._commands: dict[str, Callable[[list[str]], list[str]]] = {
            "ECHO": self._set_echo,
            "GETINFO": self._info,
            "OUTPUT": self._output,
            "OUTADD_RS422": self._outadd,
            "GETOUTINFO_RS422": self._outinfo,
            "MEASRATE": self._measrate,
            "OUTHOLD": lambda a: [],
            "RESETCNT": self._reset,
        }

    def receive(self, data: bytes) -> bytes:
        """Take command bytes; returns the answers."""
        self._line += data
        out = b""
        while b"\n" in self._line:
            line, _, rest = self._line.partition(b"\n")
            self._line = bytearray(rest)
            out += self._answer(line.decode("ascii", "replace").strip())
        return out

    def _answer(self, line: str) -> bytes:
        if not line:
            return b"->"
        name, *args = line.replace("(", " ").replace(")", " ").split()
        handler = self._commands.get(name.upper())
        if handler is None:
            return f"E200 Unknown command {name}\r\n->".encode()
        try:
            lines = handler([a.upper() for a in args])
        except ValueError as error:
            return f"E210 {error}\r\n->".encode()
        if self._echo and not lines:
            lines = [f"{line} ok"]
        return "".join(f"{text}\r\n" for text in lines).encode() + b"->"

    def _set_echo(self, args: list[str]) -> list[str]:
        self._echo = args[:1] != ["OFF"]
        return []

    def _info(self, _: list[str]) -> list[str]:
        return [
            "Name: ILD1420",
            f"Serial: {self._serial}",
            "Option: 000",
            "Article: 4120232",
            f"Measuring range: {self._config.range_m * 1e3:.2f}mm",
            "Version: 001.019",
        ]

    def _output(self, args: list[str]) -> list[str]:
        if args:
            self._streaming = args == ["RS422"]
            return []
        return [f"OUTPUT {'RS422' if self._streaming else 'NONE'}"]

    def _outadd(self, args: list[str]) -> list[str]:
        unknown = set(args) - {"NONE", "COUNTER", "TIMESTAMP"}
        if unknown:
            raise ValueError(f"Unknown output {sorted(unknown)}")
        self._extra = tuple(a for a in ("COUNTER", "TIMESTAMP") if a in args)
        return []

    def _outinfo(self, _: list[str]) -> list[str]:
        return [" ".join(("GETOUTINFO_RS422", "DIST", *self._extra))]

    def _measrate(self, args: list[str]) -> list[str]:
        if not args:
            return [f"MEASRATE {self._rate_hz / 1000:g}"]
        if args[0] not in {"0.25", "0.5", "1", "2", "4"}:
            raise ValueError(f"Rate {args[0]} kHz not possible")
        self._rate_hz = float(args[0]) * 1000
        self._next = 0
        return []

    def _reset(self, args: list[str]) -> list[str]:
        if not args or "MEASCNT" in args:
            self._counter = 0
        return []

    def sample(self, motion: Trajectory) -> bytes:
        """The stream's bytes for the samples that fall into a stretch of motion."""
        period = 1.0 / self._rate_hz
        last = int(np.floor(float(self._clock.device_s(motion.time_s[-1])) / period))
        if self._next == 0:  # first call: start counting now
            self._next = int(np.floor(float(self._clock.device_s(motion.time_s[0])) / period)) + 1
        numbers = np.arange(self._next, last + 1)
        self._next = max(self._next, last + 1)
        if not len(numbers):
            return b""
        counter = (self._counter + np.arange(len(numbers))) % optoncdt.COUNTER_WRAP
        self._counter = int(counter[-1] + 1) % optoncdt.COUNTER_WRAP
        device_s = numbers * period
        times = np.clip(self._clock.rig_s(device_s), motion.time_s[0], motion.time_s[-1])
        seen = self._look[0] * motion.at(times, 0, 4) + self._look[1] * motion.at(times, 1, 5)
        seen = seen + self._offset + self._noise * self._rng.standard_normal(len(numbers))
        if not self._streaming:
            return b""
        return optoncdt.encode_block(self._words(seen, counter, device_s))

    def _words(
        self, seen: NDArray[np.floating], counter: NDArray[np.int_], device_s: NDArray[np.floating]
    ) -> NDArray[np.uint32]:
        half = 0.5 * self._config.range_m
        codes = optoncdt.code(np.clip(seen, -half, half) + half, self._config.range_m).astype(np.int64)
        codes[seen > half] = _ERROR_BEHIND
        codes[seen < -half] = _ERROR_BEFORE
        ticks = np.rint(device_s / optoncdt.TICK_S).astype(np.int64) % optoncdt.TIMESTAMP_WRAP
        columns = [codes]
        if "COUNTER" in self._extra:
            columns.append(counter)
        if "TIMESTAMP" in self._extra:
            columns += [ticks & 0xFFFF, ticks >> 16]
        if len(columns) * 30 * self._rate_hz > self._config.baud:
            columns[0] = np.full_like(codes, _ERROR_BAUD)
        return np.column_stack(columns).astype(np.uint32)
