"""The sensor's end of the optoNCDT command line: ASCII commands in, answers out.

Used by the simulated sensor and by the stand-in for a sensor of a log. A command is a line. The answer consists of
lines of information, of an error ``E200 …``, or, if the echo is on, of the command itself and ``ok``. The prompt
follows. An answer may be sent between two blocks of the stream, never inside one. Source: ILD1420 manual, ASCII
commands.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from daq.drivers.optoncdt import sensor_answers

RATES_HZ = (250.0, 500.0, 1000.0, 2000.0, 4000.0)
OUTPUTS = ("COUNTER", "TIMESTAMP")
"""Outputs that may follow the distance in a block, in stream order."""

_LINE_LIMIT = 256  # bytes; the longest command is well under 100


def _nothing() -> None:
    return


class SensorCommands:
    """Command interpreter of a sensor.

    Attributes:
        streaming: whether the sensor was commanded to send measurements.
        rate_Hz: measuring rate, Hz.
        outputs: outputs that follow the distance in a block.

    Args:
        info: lines of the answer to GETINFO, see `info_lines`.
        rate_Hz: initial measuring rate, Hz.
        outputs: outputs that can follow the distance in a block, in stream order.
        fixed: whether the stream cannot change: another rate, or a stream without one of the outputs, is refused.
        rate_set: called when a rate was commanded.
        counter_reset: called when the measurement counter restarts at 0.
    """

    def __init__(
        self,
        info: Sequence[str],
        rate_Hz: float,
        outputs: Sequence[str] = OUTPUTS,
        *,
        fixed: bool = False,
        rate_set: Callable[[], None] = _nothing,
        counter_reset: Callable[[], None] = _nothing,
    ) -> None:
        self.streaming: bool = False
        self.rate_Hz: float = rate_Hz
        self.outputs: tuple[str, ...] = tuple(outputs) if fixed else ()
        self._info, self._possible, self._fixed = list(info), tuple(outputs), fixed
        self._rates = (rate_Hz,) if fixed else RATES_HZ
        self._rate_set, self._counter_reset = rate_set, counter_reset
        self._echo = True
        self._line = bytearray()
        self._commands: dict[str, Callable[[list[str]], list[str]]] = {
            "ECHO": self._set_echo,
            "GETINFO": lambda _: self._info,
            "OUTPUT": self._output,
            "OUTADD_RS422": self._outadd,
            "GETOUTINFO_RS422": lambda _: [" ".join(("GETOUTINFO_RS422", sensor_answers.DISTANCE, *self.outputs))],
            "MEASRATE": self._measrate,
            "OUTHOLD": lambda _: [],
            "OUTREDUCEDEVICE": lambda _: [],
            "MASTERMV": lambda _: [],
            "TRIGGER": lambda _: [],
            "AVERAGE": lambda _: [],
            "RESETCNT": self._reset,
        }

    def receive(self, data: bytes) -> bytes:
        """Take command bytes, split at any place; return the answers to the commands that they complete."""
        *lines, tail = (bytes(self._line) + data).split(b"\n")
        self._line = bytearray(tail[-_LINE_LIMIT:])
        return b"".join(self._answer(line.decode("ascii", "replace").strip()) for line in lines)

    def _answer(self, line: str) -> bytes:
        name, *args = line.replace("(", " ").replace(")", " ").split() or [""]
        if not name:
            return sensor_answers.PROMPT.encode()
        command = self._commands.get(name.upper())
        if command is None:
            lines = [f"E200 Unknown command {name}"]
        else:
            try:
                lines = command([a.upper() for a in args])
                if self._echo and not lines:
                    lines = [f"{line} ok"]
            except ValueError as refusal:
                lines = [f"E210 {refusal}"]
        text = "".join(f"{each}\r\n" for each in lines) + sensor_answers.PROMPT
        return text.encode("ascii", "replace")

    def _set_echo(self, args: list[str]) -> list[str]:
        self._echo = args[:1] != ["OFF"]
        return []

    def _output(self, args: list[str]) -> list[str]:
        if not args:
            return [f"OUTPUT {'RS422' if self.streaming else 'NONE'}"]
        if args == ["RS422"] and self._fixed and self.outputs != self._possible:
            raise ValueError(f"Output not possible without {' '.join(self._possible)}")
        self.streaming = args == ["RS422"]
        return []

    def _outadd(self, args: list[str]) -> list[str]:
        unknown = set(args) - {"NONE", *self._possible}
        if unknown:
            raise ValueError(f"Unknown output {sorted(unknown)}")
        self.outputs = tuple(name for name in self._possible if name in args)
        return []

    def _measrate(self, args: list[str]) -> list[str]:
        if not args:
            return [f"MEASRATE {self.rate_Hz / 1000:g}"]
        possible = {f"{rate / 1000:g}": rate for rate in self._rates}
        if args[0] not in possible:
            raise ValueError(f"Rate {args[0]} kHz not possible, only {' '.join(possible)}")
        self.rate_Hz = possible[args[0]]
        self._rate_set()
        return []

    def _reset(self, args: list[str]) -> list[str]:
        if not args or "MEASCNT" in args:
            self._counter_reset()
        return []


def info_lines(info: sensor_answers.SensorInfo) -> list[str]:
    """Return the answer to GETINFO that `sensor_answers.parse_info` converts to the same `info`."""
    millimetres = f"{info['range_m'] * 1e3:.2f}"
    if float(millimetres) / 1000.0 != info["range_m"]:
        millimetres = f"{info['range_m'] * 1e3:.12f}"
    return [
        f"Name: {_text(info['name'])}",
        f"Serial: {_text(info['serial'])}",
        f"Measuring range: {millimetres}mm",
        f"Version: {_text(info['version'])}",
    ]


def outputs_of(words: Sequence[str]) -> tuple[str, ...]:
    """Return the outputs after the distance that give a stream of these words; inverse of `parse_outinfo`."""
    low, high = sensor_answers.TIMESTAMP_LO, sensor_answers.TIMESTAMP_HI
    return tuple("TIMESTAMP" if word == low else word for word in words[1:] if word != high)


def _text(value: str) -> str:
    """Replace characters that a sensor cannot send."""
    return "".join(letter if " " <= letter <= "~" else "?" for letter in value)
