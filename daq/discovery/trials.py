"""Trials: the settings with which a device of each installed driver is looked for, and what its bytes give."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate
from statistics import linear_regression
from typing import Any

from pydantic import ValidationError

from daq.drivers.contract import FOREIGN, DeviceLine
from daq.drivers.driver import Driver
from daq.drivers.identification import LOSSES_OF_READINGS, FoundDevice
from daq.drivers.registry import driver
from daq.errors import DeviceError
from daq.items import RX, Batch
from daq.transports.slcan import HostText
from rig_configs.device import DeviceSettings
from rig_configs.drivers import installed

_log = logging.getLogger(__name__)

_DEVICE = "device"
_MIN_SAMPLES = 10  # fewer are accepted without any loss only
_FEWEST_SAMPLES = 3
_MAX_LOSSES, _MAX_LOSSES_CHECKED = 0.05, 0.5  # losses in relation to samples; the second for messages with a checksum
_RATE_TOLERANCE = 0.03
_MIN_SPAN_S = 0.1  # host time between the first and the last read of a rate
_STEPS = (1.0, 1.25, 1.6, 2.0, 2.5, 3.125, 4.0, 5.0, 8.0, 10.0)  # usual sample rates, times a power of ten

Reads = Sequence[tuple[bytes, int]]
"""Bytes of each read, with its host time, ns since 1970."""


@dataclass(frozen=True)
class Trial:
    """A driver with settings to try."""

    driver: Driver
    settings: DeviceSettings

    @property
    def line(self) -> DeviceLine:
        """Line of a device with these settings."""
        return self.driver.line(self.settings)

    def with_settings(self, known: Mapping[str, Any]) -> Trial:
        """Return the trial with other settings; unchanged if they are not valid."""
        table = {**self.settings.model_dump(), **{key: plain_number(value) for key, value in known.items()}}
        try:
            return replace(self, settings=self.driver.settings.model_validate(table))
        except ValidationError as error:
            _log.debug("settings %s of %s refused: %s", known, self.driver.name, error)
            return self


@dataclass(frozen=True)
class Evidence:
    """What a port gives with a trial: by the bytes received without a request, and by an answer.

    Attributes:
        trial: the trial, with the settings that the device reports.
        found: settings and identity that the device reports.
        samples: number of decoded samples of the channel with most of them; 0 if the device does not send.
        losses: number of losses on the line, without messages of other devices and samples without a valid reading.
        rate_Hz: sample rate by the host's clock, Hz; NaN without two reads with samples.
    """

    trial: Trial
    found: FoundDevice
    samples: int = 0
    losses: int = 0
    rate_Hz: float = math.nan

    @property
    def settings(self) -> Mapping[str, Any]:
        """Settings of the rig file's table, as far as they are known, without driver and port."""
        known = {key: plain_number(value) for key, value in self.found.settings.items()}
        rate = usual_rate(self.rate_Hz)
        if rate is None or "rate_Hz" in known:
            return known
        measured = {"rate_Hz": plain_number(rate)}
        accepted = getattr(self.trial.with_settings(measured).settings, "rate_Hz", None) == rate
        return known | measured if accepted else known

    @property
    def convinces(self) -> bool:
        """Whether the bytes are those of such a device."""
        checked = "checksum" in self.trial.driver.claims
        few = self.samples >= _FEWEST_SAMPLES and not self.losses
        limit = (_MAX_LOSSES_CHECKED if checked else _MAX_LOSSES) * self.samples
        return few or (self.samples >= _MIN_SAMPLES and self.losses <= limit)

    @property
    def rank(self) -> tuple[float, int]:
        """Key by which the best evidence is the smallest: losses in relation to samples, then most samples."""
        return (self.losses / max(1, self.samples), -self.samples)


def drivers_found() -> tuple[list[Driver], list[str]]:
    """Return the installed drivers, and a message for each that cannot be loaded."""
    drivers: list[Driver] = []
    failed: list[str] = []
    for name in installed():
        try:
            drivers.append(driver(name))
        except DeviceError as error:
            failed.append(str(error))
    return drivers, failed


def trials_of(drivers: Iterable[Driver], port: str, has_rate: bool) -> list[Trial]:
    """Return the trials for a port: the most frequent settings of all drivers, then the next ones, and so on.

    Args:
        port: the port.
        has_rate: whether the port has a line rate; otherwise settings that differ in their line only are tried once.
    """
    by_driver: list[list[Trial]] = []
    for each in drivers:
        try:
            trials = [Trial(each, each.example_at(port, **usual)) for usual in each.usual]
        except (ValidationError, ValueError) as error:
            _log.warning("driver %s is left out, its example is not valid: %s", each.name, error)
            continue
        trials = [trial for trial in trials if _may_be_on(trial, port, has_rate)]
        by_driver.append(trials if has_rate else _one_per_protocol(trials))
    longest = max(map(len, by_driver), default=0)
    return [trials[i] for i in range(longest) for trials in by_driver if i < len(trials)]


def _may_be_on(trial: Trial, port: str, has_rate: bool) -> bool:
    """Whether such a device can be on a port: on a CAN channel a device of a bus, on a serial port one with a rate.

    A device that a file describes is not looked for.
    """
    if trial.settings.files:
        return False
    if port.startswith("can:"):
        return trial.line.bitrate is not None
    return trial.line.baud > 0 or not has_rate


def _one_per_protocol(trials: Iterable[Trial]) -> list[Trial]:
    line = {"baud", "parity", "rate_Hz"}
    return list({repr(trial.settings.model_dump(exclude=line)): trial for trial in reversed([*trials])}.values())[::-1]


def evidence_of(trial: Trial, reads: Reads) -> Evidence | None:
    """Decode received bytes by a trial; None if the driver does not recognise or decode them."""
    if trial.line.bitrate is not None and not trial.line.port.startswith("can:"):
        text = HostText()
        reads = [(records, host_ns) for data, host_ns in reads if (records := text.received(data))]
    found = FoundDevice()
    if trial.driver.recognise is not None:
        recognised = trial.driver.recognise(trial.settings, b"".join(data for data, _ in reads))
        if recognised is None:
            return None
        found, trial = recognised, trial.with_settings(recognised.settings)
    first = _decoded(trial, found, reads)
    nominal = getattr(trial.settings, "rate_Hz", None)
    if first is None or "rate_Hz" in found.settings or not isinstance(nominal, int | float):
        return first
    rate = usual_rate(first.rate_Hz)
    if rate is None or abs(rate / nominal - 1) < _RATE_TOLERANCE:
        return first
    again = _decoded(trial.with_settings({"rate_Hz": rate}), found, reads)
    return min((each for each in (first, again) if each is not None), key=lambda each: each.rank)


def _decoded(trial: Trial, found: FoundDevice, reads: Reads) -> Evidence | None:
    try:
        pipeline = trial.driver.pipeline(_DEVICE, trial.settings, {})
        topics = {channel.topic for channel in trial.driver.channels(trial.settings)}
        counts: list[tuple[int, int]] = []  # host time and samples of each read
        for data, host_ns in [*reads, (b"", reads[-1][1] if reads else 0)]:
            items = pipeline.feed(RX, data, host_ns)
            batches = [item for item in items if isinstance(item, Batch) and item.channel.topic in topics]
            counts.append((host_ns, max((len(batch.time_ns) for batch in batches), default=0)))
    except (DeviceError, ValueError) as error:
        _log.debug("bytes not decoded by %s: %s", trial.driver.name, error)
        return None
    samples = sum(count for _, count in counts)
    kinds = (kind for kind in pipeline.losses if kind not in LOSSES_OF_READINGS and not kind.startswith(FOREIGN))
    losses = sum(pipeline.losses[kind] for kind in kinds)
    return Evidence(trial, found, samples, losses, _rate(counts[:-1]))


def _rate(counts: Sequence[tuple[int, int]]) -> float:
    """Return the sample rate by the host's times of the reads with samples."""
    filled = [(host_ns, count) for host_ns, count in counts if count]
    if len(filled) < 3:
        return math.nan
    times_s = [(host_ns - filled[0][0]) * 1e-9 for host_ns, _ in filled]
    if times_s[-1] < _MIN_SPAN_S:
        return math.nan
    totals = list(accumulate(count for _, count in filled))
    return linear_regression(times_s, totals).slope


def plain_number(value: Any) -> Any:
    """Return a float without a fraction as int, which settings of both types accept; other values unchanged."""
    return int(value) if isinstance(value, float) and value.is_integer() else value


def usual_rate(rate_Hz: float) -> float | None:
    """Return the usual sample rate nearest to a measured one, Hz; the measured one if none is near, None for NaN."""
    if not rate_Hz > 0 or not math.isfinite(rate_Hz):
        return None
    decade = 10.0 ** math.floor(math.log10(rate_Hz))
    near = min((step * decade for step in _STEPS), key=lambda step: abs(step - rate_Hz))
    return near if abs(near / rate_Hz - 1) < _RATE_TOLERANCE else float(f"{rate_Hz:.3g}")
