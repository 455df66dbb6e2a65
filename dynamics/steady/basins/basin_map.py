"""Basins: the stable motion reached by each release of a grid."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dynamics.arrays import Array, Flags, Indices
from dynamics.equations.parameters import RigOrParameters
from dynamics.errors import OutsideDomain
from dynamics.motions.locked_motion import locked_state
from dynamics.steady.basins.ends import NEAR_RAD, End, steady_ends, with_slipping
from dynamics.steady.basins.following import STATED_ERROR_RAD, FollowedReleases, follow
from dynamics.steady.basins.slipping_orbits import SlippingOrbit, slipping_orbit
from dynamics.steady.basins.turning import RevolutionMap
from rig_basics.tabular import Column, Tabular

_FIRST = 12  # number of releases simulated before all others, to find slipping orbits
_SCOUTS = 6  # number of releases simulated longer, to find their slipping orbits
_SCOUTED = 3000  # revolutions of these
_EVALUATED = 1500  # last revolutions of these that are evaluated
_FIRST_PASS = 0.8  # progress after the first pass; the rest is for further slipping orbits
_SAME_RATE = 1e-5  # turns per revolution: difference of rates below which two orbits are the same


@dataclass(frozen=True)
class BasinMap(Tabular):
    """End states of the releases of a grid.

    Attributes:
        theta3_rad, theta4_rad: angles of A and B at the release, shapes (n3,) and (n4,).
        ends: the stable motions.
        end: index into `ends`, −1 for a release that did not settle in time, shape (n4, n3).
        sure: False at a boundary: a neighbour at the stated error, simulated less accurately, has another end.
        caught_s, settled_s: time until the motion entered the region of its end, and until it stayed near it; NaN if it
            did not.
        amplitude_m: rms distance of the disk centre from its mean at the end of the time.
        apart_rad: largest distance from the neighbour, inf beyond 0.02.
        turns: turns of A and B relative to the rotor until the region was entered, shape (n4, n3, 2).
        seconds, stated_error_rad: arguments of `basins`.
        speed_rad_s: speed of the rotor.
    """

    theta3_rad: Array
    theta4_rad: Array
    ends: tuple[End, ...]
    end: Indices
    sure: Flags
    caught_s: Array
    settled_s: Array
    amplitude_m: Array
    apart_rad: Array
    turns: Array
    seconds: float
    stated_error_rad: float
    speed_rad_s: float

    @property
    def shares(self) -> Array:
        """Fraction of the grid for each end, and last the fraction without an end, shape (ends + 1,)."""
        wanted = [*range(len(self.ends)), -1]
        return np.array([np.count_nonzero(self.end == i) / self.end.size for i in wanted])

    @property
    def heading(self) -> str:
        """Share of each end."""
        shares = zip([*(end.words for end in self.ends), "not settled"], self.shares, strict=True)
        return "BasinMap: " + "; ".join(f"{100 * share:.3g} % {words}" for words, share in shares if share)

    def columns(self) -> Mapping[str, Column]:
        """Return a row for each release."""
        theta3, theta4 = np.meshgrid(self.theta3_rad, self.theta4_rad)
        return {
            "theta3_rad": theta3.ravel(),
            "theta4_rad": theta4.ravel(),
            "end": self.end.ravel(),
            "name": np.array([*(end.name for end in self.ends), "not settled"])[self.end.ravel()],
            **{name: getattr(self, name).ravel() for name in ("sure", "settled_s", "amplitude_m")},
            "turns3": self.turns[..., 0].ravel(),
            "turns4": self.turns[..., 1].ravel(),
        }


def basins(
    rig: RigOrParameters,
    speed_rad_s: float,
    theta3_rad: Sequence[float] | Array,
    theta4_rad: Sequence[float] | Array,
    seconds: float = 20.0,
    *,
    stated_error_rad: float = STATED_ERROR_RAD,
    workers: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> BasinMap:
    """Compute the end states of releases from a grid of locked angles.

    Args:
        rig: RotorParameters, or an object whose `.physics` is one.
        theta3_rad, theta4_rad: angles of A and B at the release.
        seconds: simulated time of each release, s.
        stated_error_rad: error of the angles within which an end counts as sure.
        workers: number of threads. None: one per core.
        progress: called with the completed share, 0 … 1.
    Raises:
        OutsideDomain: dry friction, no pendulum, no imbalance, or invalid numbers.
        NotConverged: the steady states cannot be computed.
    Source: docs/theory/basins.md.
    """
    turning = RevolutionMap.of(rig, speed_rad_s)
    three, four = np.array(theta3_rad, np.float64), np.array(theta4_rad, np.float64)
    for name, angles in (("theta3_rad", three), ("theta4_rad", four)):
        if angles.ndim != 1 or not len(angles) or not np.all(np.isfinite(angles)):
            raise OutsideDomain(f"{name}: expected finite angles, shape (n,), got shape {angles.shape}")
    grid = np.array([(a, b) for b in four for a in three])
    starts = released(turning, grid)
    ends, found = follow_to_all(turning, starts, seconds, stated_error_rad, workers, progress)
    shape = (len(four), len(three))
    return BasinMap(
        three,
        four,
        tuple(ends),
        found.end.reshape(shape),
        found.sure.reshape(shape),
        found.caught_s.reshape(shape),
        found.settled_s.reshape(shape),
        found.amplitude_m.reshape(shape),
        found.apart_rad.reshape(shape),
        found.turns.reshape(*shape, 2),
        float(seconds),
        float(stated_error_rad),
        turning.speed_rad_s,
    )


def released(turning: RevolutionMap, theta_rad: Array) -> Array:
    """States on the locked orbit at ψ = 0, shape (n, 8), for angles (n, 2)."""
    p, w = turning.parameters, turning.speed_rad_s
    return locked_state(p, w, 0.0, *theta_rad.T)


def follow_to_all(
    turning: RevolutionMap,
    starts: Array,
    seconds: float,
    stated_error_rad: float,
    workers: int | None,
    progress: Callable[[float], None] | None,
) -> tuple[list[End], FollowedReleases]:
    """Simulate releases to steady states and to the slipping orbits that they lead to."""
    steady = steady_ends(turning)
    few = np.unique(np.linspace(0, len(starts) - 1, _FIRST).astype(int))
    first = follow(turning, starts[few], steady, seconds, stated_error_rad=stated_error_rad, workers=workers)
    orbits = _scouted(turning, first.last[first.end < 0], [])
    ends = with_slipping(steady, orbits)
    notify = _part(progress, 0.0, _FIRST_PASS)
    found = follow(turning, starts, ends, seconds, stated_error_rad=stated_error_rad, workers=workers, progress=notify)
    left = np.flatnonzero(found.end < 0)
    while len(left):
        added = _scouted(turning, found.last[left], orbits)
        if not added:
            break
        orbits += added
        ends = with_slipping(steady, orbits)
        notify = _part(progress, _FIRST_PASS, 1.0)
        again = follow(
            turning, starts[left], ends, seconds, stated_error_rad=stated_error_rad, workers=workers, progress=notify
        )
        found.put(left, again)
        left = np.flatnonzero(found.end < 0)
    return ends, found


def _part(progress: Callable[[float], None] | None, begin: float, end: float) -> Callable[[float], None] | None:
    """Progress of a part of the work, as a share of the whole."""
    return None if progress is None else lambda share: progress(begin + share * (end - begin))


def _scouted(turning: RevolutionMap, last: Array, known: Sequence[SlippingOrbit]) -> list[SlippingOrbit]:
    """New slipping orbits that some of the releases reach when they are simulated longer."""
    found = list[SlippingOrbit]()
    if not len(last):
        return found
    chosen = last[np.unique(np.linspace(0, len(last) - 1, _SCOUTS).astype(int))]
    for state in chosen:
        strobe = turning.strobed(state, _SCOUTED)[-_EVALUATED:]
        orbit = slipping_orbit(turning, strobe, NEAR_RAD)
        if orbit is not None and not any(same_orbit(orbit, other) for other in [*known, *found]):
            found.append(orbit)
    return found


def same_orbit(one: SlippingOrbit, other: SlippingOrbit) -> bool:
    """Whether the rates of two slipping orbits are equal."""
    apart = np.array(one.turns_per_revolution) - np.array(other.turns_per_revolution)
    return bool(np.all(np.abs(apart) < _SAME_RATE))
