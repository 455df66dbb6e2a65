"""Parts of a driver of a plain sensor: it sends a line for each sample, with its number, between two commands.

`LinePipeline` decodes the lines, `SimulatedSensor` is the far end, and `PlayedSensor` the stand-in of a log. A driver
adds what is its own: how a line is read and written, and which commands there are.
"""

from __future__ import annotations

import queue
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.channels import Channel
from daq.clock import ClockMap, ClockSeed, Unwrap
from daq.drivers.contract import SampleClock, Talk
from daq.drivers.played import PlayedDevice
from daq.drivers.simulated import FarEnd, MotionInterval
from daq.errors import DeviceError
from daq.items import TX, Batch, DeviceEvent, lost_samples
from daq.numbered.messages import Count, Stretch, chained
from daq.numbered.stream import NumberedStream
from rig_configs.device import DeviceSettings

_ANSWER_S = 1.0
Items = list[Batch | DeviceEvent]


@dataclass(frozen=True)
class Reading:
    """The sample of one line.

    Attributes:
        number: its number, as the sensor counts.
        values: values of the channel's fields, without the last two.
        time: time of the sensor's clock; 0 without one.
    """

    number: int
    values: tuple[float, ...]
    time: int = 0


class LinePipeline:
    """Decoder of lines; see Pipeline.

    Args:
        device: name of the device in the rig file.
        channel: its channel; the last two fields are the sample's number and the time of the sensor's clock.
        count: numbers and clock of its samples.
        parse: returns the sample of a line without its end, a text for a reply, or None for a damaged line.
        tolerance_ppm: standard uncertainty of the rate of the sensor's clock.
        identity: the device's identity.
        longest: bytes of the longest line, its end not counted.

    Attributes:
        losses: see Pipeline. "samples": missing by their number; "damaged_lines": dropped.
    """

    def __init__(
        self,
        device: str,
        channel: Channel,
        count: Count,
        parse: Callable[[bytes], Reading | str | None],
        tolerance_ppm: float,
        identity: Mapping[str, Any],
        longest: int = 64,
    ) -> None:
        self.losses: dict[str, int] = {"samples": 0, "damaged_lines": 0}
        self._device, self._channel, self._count, self._parse = device, channel, count, parse
        self._tolerance_ppm, self._longest = tolerance_ppm, longest
        self._received, self._heard, self._last_ns = b"", False, 0
        self._order = NumberedStream[list[Reading]](count, chained)
        self._begin(ClockSeed.of(identity))

    def _begin(self, seed: ClockSeed | None = None) -> None:
        self._times = Unwrap(self._count.clock_size or 2**62)
        self._clock = ClockMap(self._tolerance_ppm, seed)

    @property
    def clock_std_ns(self) -> float:
        """See StatesClockError."""
        return self._clock.std_ns

    @property
    def clock_seed(self) -> ClockSeed | None:
        """See HasClockSeed."""
        cycle = self._count.clock_size / self._count.clock_step or self._count.size / self._count.step
        return self._clock.seed(round(cycle * self._count.period_ns))

    def feed(self, direction: int, data: bytes, host_ns: int) -> Items:
        """See Pipeline."""
        if direction == TX:
            return []
        if not data:
            return [item for stretch in self._order.end() for item in self._placed(stretch)]
        *lines, rest = (self._received + data).split(b"\n")
        self._received = rest[: self._longest + 2]  # a longer one is damaged
        out: Items = []
        readings: list[Reading] = []
        for line in lines:
            found = self._parse(line[: self._longest + 2].removesuffix(b"\r"))
            if isinstance(found, Reading):
                readings.append(found)
            elif found is not None:
                out.append(DeviceEvent("reply", self._device, found))
            elif self._heard:  # the first line may have begun before the port was open
                self.losses["damaged_lines"] += 1
                out.append(DeviceEvent("damage", self._device, "a damaged line was dropped", {"lines": 1}))
            self._heard = True
        if readings:
            numbers, times = (np.array([getattr(each, name) for each in readings]) for name in ("number", "time"))
            clock = times if self._count.clock_size else None
            out += [i for found in self._order.feed(numbers, readings, host_ns, clock) for i in self._placed(found)]
        return out

    def _placed(self, stretch: Stretch[list[Reading]]) -> Items:
        out: Items = []
        if stretch.is_restart:
            self._begin()
            out.append(DeviceEvent("restart", self._device, "its samples' number does not continue: it started again"))
        elif stretch.lost:
            self.losses["samples"] += stretch.lost
            about = {"uncertain_samples": stretch.lost} if stretch.is_about else {}
            out.append(lost_samples(self._device, stretch.lost, stretch.lost * self._count.period_ns * 1e-9, **about))
        return [*out, self._batch(stretch)]

    def _batch(self, stretch: Stretch[list[Reading]]) -> Batch:
        count, numbers = self._count, stretch.numbers
        own, tick = numbers, count.period_ns / count.step
        if count.clock_size:
            own, tick = (
                self._times.feed(np.array([each.time for each in stretch.rows])),
                count.period_ns / count.clock_step,
            )
        time_ns = self._clock.map(np.rint(own * tick).astype(np.int64), stretch.host_ns)
        if time_ns[0] <= self._last_ns:  # a new map of a sensor that started again
            time_ns = np.maximum(time_ns, self._last_ns + 1 + np.arange(len(time_ns)))
        self._last_ns = int(time_ns[-1])
        *names, number, time = (name for name, _ in self._channel.fields)
        values = np.array([each.values for each in stretch.rows], float)
        sequence = (numbers % count.size).astype(np.uint32)
        columns: dict[str, NDArray[Any]] = {name: values[:, i] for i, name in enumerate(names)}
        columns |= {number: sequence, time: own.astype(np.uint64)}
        return Batch(self._channel, time_ns, sequence, columns)


@dataclass(frozen=True)
class Commands:
    """Commands of a sensor, each a line.

    Attributes:
        start: begins the stream; empty if the sensor sends as long as it has power.
        stop: ends the stream.
        answers: bytes of the answer to a command.
    """

    start: bytes = b""
    stop: bytes = b""
    answers: Mapping[bytes, bytes] = field(default_factory=dict[bytes, bytes])


def line_clock(count: Count, field: str, settings: Any) -> tuple[SampleClock, ...]:
    """Return the clock of a sensor with these samples.

    Args:
        count: numbers and clock of its samples.
        field: the channel's field that contains the clock's time.
        settings: the sensor's, with `topic` and `clock_tolerance_ppm`.
    """
    tick_ns = round(count.period_ns / (count.clock_step if count.clock_size else count.step))
    rate_Hz, tolerance = 1e9 / count.period_ns, settings.clock_tolerance_ppm
    return (SampleClock(settings.topic, rate_Hz, tolerance, field, tick_ns, count.size),)


class _Console:
    """The sensor's side of its commands."""

    def __init__(self, commands: Commands) -> None:
        self._commands, self._received = commands, b""
        self._longest = max(map(len, [commands.start, commands.stop, *commands.answers]))
        self.sends: bool = not commands.start
        self.count: int = 0

    def hear(self, data: bytes) -> bytes:
        """Take bytes that may be cut anywhere; return the answers."""
        *lines, self._received = (self._received + data).split(b"\n")
        self._received = self._received[-self._longest - 1 :]
        self.count += len(lines)
        for line in lines:
            if line and line in (self._commands.start, self._commands.stop):
                self.sends = line == self._commands.start
        return b"".join(self._commands.answers.get(line, b"") for line in lines)


class SimulatedSensor(FarEnd):
    """Far end that sends a message for each period of its own clock.

    Args:
        clock: clock of the device, `World.clock`.
        period_s: period of its samples, s.
        messages: returns the bytes of samples from their numbers, shape (n,), and the motion at their instants: a
            function from the column of the value and that of its rate, see MotionInterval.
        commands: its commands.
    """

    def __init__(
        self,
        clock: Any,
        period_s: float,
        messages: Callable[[NDArray[np.int64], Callable[[int, int], NDArray[np.floating]]], bytes],
        commands: Commands | None = None,
    ) -> None:
        self._clock, self._period_s, self._messages = clock, period_s, messages
        self._console = _Console(commands or Commands())
        self._next: int | None = None

    def receive(self, data: bytes, now_s: float) -> bytes:
        """See FarEnd."""
        return self._console.hear(data)

    def sample(self, motion: MotionInterval) -> bytes:
        """See FarEnd."""
        first, last = (int(float(self._clock.device_s(motion.time_s[i])) // self._period_s) for i in (0, -1))
        numbers = np.arange(first + 1 if self._next is None else self._next, last + 1)
        self._next = max(last + 1, self._next or 0)
        if not self._console.sends or not len(numbers):
            return b""
        times = np.clip(self._clock.rig_s(numbers * self._period_s), motion.time_s[0], motion.time_s[-1])
        return self._messages(numbers, lambda value, rate: motion.at(times, value, rate))


class PlayedSensor(PlayedDevice):
    """Stand-in that answers commands, and sends after the one that begins the stream.

    Args:
        commands: its commands.
    """

    def __init__(self, commands: Commands) -> None:
        super().__init__()
        self._console = _Console(commands)
        self.expects: str = commands.start.decode("ascii", "replace")

    @property
    def sending(self) -> bool:
        """See PlayedDevice."""
        return self._console.sends

    def begin(self) -> None:
        """See PlayedDevice."""
        self._console.sends = True

    def hear(self, data: bytes) -> bytes:
        """See PlayedDevice."""
        answer = self._console.hear(data)
        self.commands: int = self._console.count
        return answer


def asked(device: str, settings: DeviceSettings, talk: Talk, request: bytes) -> str:
    """Send a request and return the answer.

    Raises:
        DeviceError: there is none.
        LinkLost: the connection to the device is lost.
    """
    talk.send(request)
    try:
        return talk.replies.get(timeout=_ANSWER_S)
    except queue.Empty:
        last = request.split(b"\n")[-2].decode("ascii", "replace")
        raise DeviceError(
            f"{device} on {settings.port}: no answer to {last}. Is it powered, and the rate of its line right?"
        ) from None
