"""Device clocks on the common clock: true errors of the mapped times against their stated uncertainty.

    uv run python -m benchmarks.clock_alignment --rigs 50

Each rig has two devices with clocks of their own, drifts up to 200 ppm, and arrivals with one-sided jitter up to 10 ms.
Devices restart, links are lost and come back, and the host's clock steps. Rigs with 2 ms of jitter show how well the
samples of a laser and of an encoder are aligned.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from daq.clock import ClockMap

Array = NDArray[np.float64]
START_NS = 1_700_000_000_000_000_000
SECONDS = 60.0
LINK_GAP_S, RESTART_GAP_S = (1.0, 8.0), 1.5
SETTLED_S = 10.0  # after which the alignment of two devices is compared


@dataclass(frozen=True)
class Device:
    """A simulated device clock and the way of its bytes.

    Attributes:
        drift: rate error of the clock.
        rate_Hz: samples per second.
        read_s: mean time between two reads, s.
        jitter_s: mean of the exponential delay of a read, s.
        restarts_s, gaps_s: times of restarts of the device, and of losses of its link, s.
    """

    drift: float
    rate_Hz: float
    read_s: float
    jitter_s: float
    restarts_s: tuple[float, ...] = ()
    gaps_s: tuple[float, ...] = ()


@dataclass(frozen=True)
class Host:
    """The host's clock, which steps by `steps_s` at `at_s`."""

    at_s: tuple[float, ...] = ()
    steps_s: tuple[float, ...] = ()

    def time_s(self, true_s: Array) -> Array:
        """Return the host's time at true times, s."""
        shown = np.array(true_s, np.float64)
        for at, step in zip(self.at_s, self.steps_s, strict=True):
            shown += np.where(true_s >= at, step, 0.0)
        return shown


@dataclass(frozen=True)
class Mapped:
    """Last sample of each read: true time, error of the mapped time and its stated standard uncertainty, s."""

    true_s: Array
    error_s: Array
    std_s: Array


def mapped(device: Device, host: Host, tolerance_ppm: float, rng: np.random.Generator) -> Mapped:
    """Send the samples of a device through a clock map and return the errors."""
    clock, begun = ClockMap(tolerance_ppm), 0.0
    rows: list[tuple[float, float, float]] = []
    now = last_arrival = 0.0
    restarts = list(device.restarts_s)
    while now < SECONDS:
        first = now
        now += device.read_s * rng.uniform(0.6, 1.4)
        if restarts and now >= restarts[0]:
            restarts.pop(0)
            now += RESTART_GAP_S
            first = now
            clock.restart()  # as the pipelines do
            begun = now
            now += device.read_s
        if any(at <= now < at + LINK_GAP_S[1] * 0.5 for at in device.gaps_s):
            continue
        numbers = np.arange(
            np.ceil((first - begun) * device.rate_Hz * (1 + device.drift)),
            np.ceil((now - begun) * device.rate_Hz * (1 + device.drift)),
        )
        if not len(numbers):
            continue
        device_s = numbers / device.rate_Hz
        true_s = begun + device_s / (1 + device.drift)
        last_arrival = max(last_arrival, float(true_s[-1]) + rng.exponential(device.jitter_s))
        arrival_ns = START_NS + round(float(host.time_s(np.array([last_arrival]))[0]) * 1e9)
        times_ns = clock.map(np.round(device_s * 1e9).astype(np.int64), arrival_ns)
        shown_s = float(host.time_s(true_s[-1:])[0])
        rows.append((float(true_s[-1]), (int(times_ns[-1]) - START_NS) * 1e-9 - shown_s, clock.std_ns * 1e-9))
    true, error, std = np.array(rows).T
    return Mapped(true, error, std)


def random_rig(seed: int) -> tuple[Device, Device, Host]:
    """Return a laser, an encoder and a host with random clocks, jitters, losses and steps."""
    rng = np.random.default_rng(seed)

    def times(most: int) -> tuple[float, ...]:
        return tuple(np.sort(rng.uniform(5.0, SECONDS - 5.0, rng.integers(0, most + 1))))

    def device(rate_Hz: float, read_s: float) -> Device:
        jitter = 10e-3 * rng.uniform() ** 2
        return Device(rng.uniform(-200e-6, 200e-6), rate_Hz, read_s, jitter, times(1), times(1))

    at = times(1)
    steps = tuple(float(rng.choice([-1, 1]) * 10 ** rng.uniform(-2, 0.5)) for _ in at)
    return device(4000.0, 0.01), device(1000.0, 0.008), Host(at, steps)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the coverage of each rig, of all, and the alignment with 2 ms of jitter."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rigs", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args(arguments)
    within, errors = list[float](), list[float]()
    for seed in range(given.seed, given.seed + given.rigs):
        *devices, host = random_rig(seed)
        rng = np.random.default_rng([seed, 1])
        for name, device in zip(("laser", "encoder"), devices, strict=True):
            found = mapped(device, host, 120.0, rng)
            share = float(np.mean(np.abs(found.error_s) <= 2 * found.std_s))
            within.append(share)
            errors += list(np.abs(found.error_s))
            print(
                f"rig {seed:3} {name:7} drift {device.drift * 1e6:+5.0f} ppm, jitter {device.jitter_s * 1e3:4.1f} ms, "
                f"{len(device.restarts_s)} restarts, {len(device.gaps_s)} losses, host steps "
                f"{[round(s, 3) for s in host.steps_s]}: within 2 std {share:6.1%}, median std "
                f"{np.median(found.std_s) * 1e6:.0f} µs, median error {np.median(np.abs(found.error_s)) * 1e6:.0f} µs",
                flush=True,
            )
    print(
        f"reads within two stated standard uncertainties: {np.mean(within):.1%} (least of a device {min(within):.1%})"
    )
    worst = []
    for seed in range(given.rigs):
        rng = np.random.default_rng([seed, 2])
        drift = rng.uniform(-200e-6, 200e-6, 2)
        laser = mapped(Device(drift[0], 4000.0, 0.01, 2e-3), Host(), 60.0, rng)
        encoder = mapped(Device(drift[1], 1000.0, 0.008, 2e-3), Host(), 60.0, rng)
        apart = np.interp(laser.true_s, encoder.true_s, encoder.error_s) - laser.error_s
        worst.append(float(np.max(np.abs(apart[laser.true_s > SETTLED_S]))))
    print(
        f"laser against encoder at 2 ms of jitter, after {SETTLED_S:g} s: median of the largest deviations "
        f"{np.median(worst) * 1e6:.0f} µs, largest {max(worst) * 1e6:.0f} µs"
    )


if __name__ == "__main__":
    main()
