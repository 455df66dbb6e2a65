"""Channels and clocks that drivers of the same role have in common."""

from __future__ import annotations

from daq import channels
from daq.channels import Channel
from daq.drivers.contract import SampleClock
from rig_configs.device import DisplacementSettings, RotorNodeSettings

TICK_NS = round(channels.DEVICE_TICK_S * 1e9)


def displacement_channels(settings: DisplacementSettings) -> tuple[Channel, ...]:
    """Return the channel of a sensor of the column's motion, which its settings name."""
    return (channels.displacement_channel(settings.topic),)


def displacement_clocks(count_wrap: int, settings: DisplacementSettings) -> tuple[SampleClock, ...]:
    """Return the clock of such a sensor, from the samples' own time or from their number and the sampling period.

    Args:
        count_wrap: modulus of the samples' counter.
        settings: the sensor's.
    """
    rate, tolerance = settings.rate_Hz, settings.clock_tolerance_ppm
    return (SampleClock(settings.topic, rate, tolerance, "device_ticks", TICK_NS, count_wrap),)


def node_channels(settings: RotorNodeSettings) -> tuple[Channel, ...]:
    """Return the pendulums' angles of a node on the rotor, unless another device measures them for the rig."""
    return (channels.PENDULUMS,) if settings.angles else ()


def node_marks(settings: RotorNodeSettings) -> tuple[Channel, ...]:
    """Return the index marks of a node on the rotor, unless another device marks the rotor's phase."""
    return (channels.TACHO,) if settings.index_marks else ()


def node_clocks(settings: RotorNodeSettings) -> tuple[SampleClock, ...]:
    """Return the clock of a node on the rotor, which counts µs, if its angles are recorded."""
    if not settings.angles:
        return ()
    rate, tolerance = settings.rate_Hz, settings.clock_tolerance_ppm
    return (SampleClock(channels.PENDULUMS.topic, rate, tolerance, "node_time_us", 1000, 2**32),)


def motor_channels(settings: object) -> tuple[Channel, ...]:
    """Return the channel of a motor's speed."""
    return (channels.MOTOR,)
