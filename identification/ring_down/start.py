"""Start values of a ring-down's two modes, and whether a record holds two at all.

Records are lists of two channels, sensors x and y, from the release on.
"""

from __future__ import annotations

import numpy as np

from identification.ring_down.modes import Start, damped_periodogram, without_mode
from identification.samples import Averages


def ring_down_starts(records: list[list[Averages]]) -> tuple[Start, Start]:
    """Start values of mode 1 (along x) and mode 2 (along y).

    The strongest signal of all gives its axis' mode. The other axis' mode is looked for where its signal is largest
    against the first; there the first mode is regressed out. When nothing is left both directions are alike.
    """
    strong, leader, best, channel = _leader(records)
    rest = without_mode(channel, leader)
    follower = damped_periodogram(rest)
    if np.var(channel.value) > np.var(records[best][strong].value) and np.var(rest.value) < 0.05 * np.var(
        channel.value
    ):
        follower = leader  # a strong signal of its own, yet the leader's mode explains it
    return (leader, follower) if strong == 0 else (follower, leader)


def _leader(records: list[list[Averages]]) -> tuple[int, Start, int, Averages]:
    """The axis of the strongest signal, its mode, and the record and channel that show the other axis best."""
    energy = np.array([[np.var(c.value) for c in record] for record in records])
    record, strong = np.unravel_index(np.argmax(energy), energy.shape)
    leader = damped_periodogram(records[record][strong])
    best = int(np.argmax(energy[:, 1 - strong] / energy[:, strong]))
    return int(strong), leader, best, records[best][1 - strong]


def lone_axis(records: list[list[Averages]]) -> tuple[int, str] | None:
    """The only direction a single record can speak of, with the reason; None when it holds both."""
    if len(records) > 1:
        return None
    strong, leader, _, channel = _leader(records)
    rest = without_mode(channel, leader)
    follower = damped_periodogram(rest)
    floor = channel.noise**2 / float(np.median(channel.count))
    if np.var(rest.value) < 1.2 * floor or follower.share < 0.15:
        return strong, f"sensor {'xy'[1 - strong]} shows no mode of its own"
    if abs(follower.omega - leader.omega) < 3 * leader.zeta * leader.omega:
        return strong, "both directions ring alike and one record does not tell them apart"
    return None
