"""Driver of a plain sensor: it sends a line for each sample, with its number, between two commands.

`LineSensor` describes the lines and commands of a kind of sensors; the rest of their driver follows.
"""

from __future__ import annotations

import queue
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from daq.channels import Channel
from daq.clock import ClockMap, ClockSeed, Unwrap
from daq.drivers.contract import Pipeline, PipelineStatus, SampleClock, Talk
from daq.drivers.driver import Driver
from daq.drivers.played import PlayedDevice
from daq.drivers.simulated import FarEnd, MotionInterval
from daq.errors import DeviceError
from daq.items import TX, Batch, DeviceEvent
from daq.numbered.messages import Count, Stretch, chained
from daq.numbered.stream import NumberedStream
from rig_configs.device import DeviceSettings

_ANSWER_S = 1.0
Items = list[Batch | DeviceEvent]
Motion = Callable[[int, int], NDArray[np.floating]]
"""The motion at the instants of samples, from the column of a value and that of its rate; see MotionInterval."""


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


@dataclass(frozen=True)
class Commands:
    """Commands of a sensor, each a line of text; those that it does not have are empty.

    Attributes:
        start: begins the stream. Without it the sensor sends as long as it has power.
        stop: ends the stream.
        identify: queries the identity.
        answer: the answer to this query, with names of the identity in braces for its words: "I {model} {serial}".
        example: an identity, that of the simulated sensor.
    """

    start: str = ""
    stop: str = ""
    identify: str = ""
    answer: str = ""
    example: Mapping[str, str] = field(default_factory=dict[str, str])

    def identity_in(self, text: str) -> dict[str, str] | None:
        """Return the identity in the text of an answer; None without one."""
        words = re.sub(r"\\{(\w+)\\}", r"(?P<\1>\\S+)", re.escape(self.answer))
        found = re.fullmatch(words, text)
        return None if found is None else found.groupdict()


@dataclass(frozen=True, kw_only=True)
class LineSensor:
    """One kind of sensors. Their settings have `topic` and `clock_tolerance_ppm`.

    Attributes:
        channel: returns the channel from the settings; the last two fields are the sample's number and the time of the
            sensor's clock.
        count: numbers and clock of the samples.
        encode: returns the bytes of a line from its text.
        parse: returns the sample of a line without its end, the text of an answer, or None for a damaged line.
        lines: returns the bytes of samples of the simulated sensor from the settings, their numbers, shape (n,), and
            the motion at their instants.
        commands: the commands.
        longest: bytes of the longest line, its end not counted.
    """

    channel: Callable[[Any], Channel]
    count: Count
    encode: Callable[[str], bytes]
    parse: Callable[[bytes], Reading | str | None]
    lines: Callable[[Any, NDArray[np.int64], Motion], bytes]
    commands: Commands = Commands()
    longest: int = 64

    def driver(self, name: str, settings: type[DeviceSettings], **others: Any) -> Driver:
        """Return the driver of the sensors.

        Args:
            name: its name.
            settings: class of a sensor's table in the rig file.
            others: further fields of Driver, for example `claims`.
        """
        return Driver(
            name=name,
            settings=settings,
            channels=lambda settings: (self.channel(settings),),
            clocks=self._clocks,
            pipeline=partial(LinePipeline, self),
            far_end=partial(SimulatedSensor, self),
            played=partial(PlayedSensor, self),
            open=self._open,
            stop=self._stop,
            **others,
        )

    def _clocks(self, settings: Any) -> tuple[SampleClock, ...]:
        count, channel = self.count, self.channel(settings)
        tick_ns = round(count.period_ns / (count.clock_step if count.clock_size else count.step))
        rate_Hz, tolerance = 1e9 / count.period_ns, settings.clock_tolerance_ppm
        return (SampleClock(channel.topic, rate_Hz, tolerance, channel.fields[-1][0], tick_ns, count.size),)

    def _open(self, device: str, settings: Any, talk: Talk) -> dict[str, Any]:
        """Query the identity, drop what an earlier stream left, and start."""
        self._stop(settings, talk)
        identity = self._queried(device, settings, talk) if self.commands.identify else {}
        talk.restart_decoding()
        _command(talk, self.commands.start)
        return identity

    def _queried(self, device: str, settings: Any, talk: Talk) -> dict[str, str]:
        commands, place = self.commands, f"{device} on {settings.port}"
        _command(talk, commands.identify)
        try:
            text = talk.replies.get(timeout=_ANSWER_S)
        except queue.Empty:
            raise DeviceError(
                f"{place}: no answer to {commands.identify}. Is it powered, and the rate of its line right?"
            ) from None
        if (found := commands.identity_in(text)) is None:
            raise DeviceError(f"{place}: expected {commands.answer!r} as answer to {commands.identify}, got {text!r}")
        return found

    def _stop(self, settings: Any, talk: Talk) -> None:
        _command(talk, self.commands.stop)


def _command(talk: Talk, text: str) -> None:
    if text:
        talk.send(f"{text}\n".encode())


class LinePipeline(Pipeline):
    """Decoder of lines; see Pipeline.

    Args:
        sensor: kind of the sensor.
        device: its name in the rig file.
        settings, identity: of the sensor.

    Attributes:
        losses: see Pipeline. "samples": missing by their number; "damaged_lines": dropped.
    """

    def __init__(self, sensor: LineSensor, device: str, settings: Any, identity: Mapping[str, Any]) -> None:
        super().__init__(device, "samples", "damaged_lines")
        self._channel = sensor.channel(settings)
        self._count, self._parse, self._longest = sensor.count, sensor.parse, sensor.longest
        self._received, self._heard = b"", False
        self._numbered = NumberedStream[list[Reading]](sensor.count, chained)
        self._times = Unwrap(sensor.count.clock_size or 2**62)
        self._clock = ClockMap(settings.clock_tolerance_ppm, ClockSeed.of(identity))

    @property
    @override
    def status(self) -> PipelineStatus:
        cycle = self._count.clock_size / self._count.clock_step or self._count.size / self._count.step
        seed = self._clock.seed(round(cycle * self._count.period_ns))
        return PipelineStatus(clock_seed=seed, clock_std_ns=self._clock.std_ns)

    @override
    def feed(self, direction: int, data: bytes, host_ns: int) -> Items:
        if direction == TX:
            return []
        if not data:
            return [item for stretch in self._numbered.end() for item in self._placed(stretch)]
        *lines, tail = (self._received + data).split(b"\n")
        self._received = tail[: self._longest + 2]  # a longer one is damaged
        out: Items = []
        readings: list[Reading] = []
        for line in lines:
            found = self._parse(line[: self._longest + 2].removesuffix(b"\r"))
            if isinstance(found, Reading):
                readings.append(found)
            elif found is not None:
                out.append(DeviceEvent("reply", self._device, found))
            elif self._heard:  # the first line may have begun before the port was open
                out.append(self.damage("damaged_lines", "a damaged line was dropped", lines=1))
            self._heard = True
        if readings:
            numbers, times = (np.array([getattr(each, name) for each in readings]) for name in ("number", "time"))
            clock = times if self._count.clock_size else None
            out += [i for found in self._numbered.feed(numbers, readings, host_ns, clock) for i in self._placed(found)]
        return out

    def _placed(self, stretch: Stretch[list[Reading]]) -> Items:
        out: Items = []
        if stretch.is_restart:
            self._times = Unwrap(self._count.clock_size or 2**62)
            self._clock.restart()
            out.append(DeviceEvent("restart", self._device, "its samples' number does not continue: it started again"))
        elif stretch.lost:
            about = {"uncertain_samples": stretch.lost} if stretch.is_about else {}
            out.append(self.lost_samples(stretch.lost, stretch.lost * self._count.period_ns * 1e-9, **about))
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
        *names, number, time = (name for name, _ in self._channel.fields)
        values = np.array([each.values for each in stretch.rows], float)
        sequence = (numbers % count.size).astype(np.uint32)
        columns: dict[str, NDArray[Any]] = {name: values[:, i] for i, name in enumerate(names)}
        columns |= {number: sequence, time: own.astype(np.uint64)}
        return Batch(self._channel, time_ns, sequence, columns)


class _Console:
    """The sensor's side of its commands.

    Attributes:
        sends: whether it sends samples.
        count: number of received lines.
    """

    def __init__(self, sensor: LineSensor, identity: Mapping[str, Any]) -> None:
        commands = sensor.commands
        self._start, self._stop, self._identify = (
            text.encode() for text in (commands.start, commands.stop, commands.identify)
        )
        self._answer = sensor.encode(commands.answer.format(**{**commands.example, **identity}))
        self._received = b""
        self.sends: bool = not commands.start
        self.count: int = 0

    def hear(self, data: bytes) -> bytes:
        """Take bytes that may be cut anywhere; return the answers."""
        *lines, tail = (self._received + data).split(b"\n")
        self._received = tail[-max(map(len, (self._start, self._stop, self._identify))) - 1 :]
        self.count += len(lines)
        out = b""
        for line in filter(None, lines):
            if line in (self._start, self._stop):
                self.sends = line == self._start
            out += self._answer if line == self._identify else b""
        return out


class SimulatedSensor(FarEnd):
    """Far end that sends a message for each period of its own clock.

    Args:
        sensor: kind of the sensor.
        device: its name in the rig file.
        settings: its settings.
        world: see `Driver.far_end`.
    """

    def __init__(self, sensor: LineSensor, device: str, settings: Any, world: Any) -> None:
        self._clock, self._period_s, self._settings = world.clock(device), 1e-9 * sensor.count.period_ns, settings
        self._lines = sensor.lines
        self._console = _Console(sensor, {})
        self._next: int | None = None

    @override
    def receive(self, data: bytes, now_s: float) -> bytes:
        return self._console.hear(data)

    @override
    def sample(self, motion: MotionInterval) -> bytes:
        first, last = (int(float(self._clock.device_s(motion.time_s[i])) // self._period_s) for i in (0, -1))
        numbers = np.arange(first + 1 if self._next is None else self._next, last + 1)
        self._next = max(last + 1, self._next or 0)
        if not self._console.sends or not len(numbers):
            return b""
        times = np.clip(self._clock.rig_s(numbers * self._period_s), motion.time_s[0], motion.time_s[-1])
        return self._lines(self._settings, numbers, lambda value, rate: motion.at(times, value, rate))


class PlayedSensor(PlayedDevice):
    """Stand-in that answers commands, and sends after the one that begins the stream.

    Args:
        sensor: kind of the sensor.
        settings, identity: of the sensor of the log.
    """

    def __init__(self, sensor: LineSensor, settings: Any, identity: Mapping[str, Any]) -> None:
        super().__init__()
        self._console = _Console(sensor, identity)
        self.expects: str = sensor.commands.start

    @property
    @override
    def sending(self) -> bool:
        return self._console.sends

    @override
    def begin(self) -> None:
        self._console.sends = True

    @override
    def hear(self, data: bytes) -> bytes:
        answer = self._console.hear(data)
        self.commands: int = self._console.count
        return answer
