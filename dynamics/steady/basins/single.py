"""One release per rig and speed, and the stable motion that it reaches: for maps over two parameters and for draws."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynamics.arrays import Array, Flags, Indices
from dynamics.equations.balancing import balanced_angles
from dynamics.equations.parameters import RigOrParameters, RotorParameters, physics_of
from dynamics.errors import DynamicsError, OutsideDomain
from dynamics.motions.locked_motion import locked_state
from dynamics.steady.basins.ends import NEAR_RAD, End, mirror_image, with_slipping
from dynamics.steady.basins.following import STATED_ERROR_RAD, follow
from dynamics.steady.basins.periodic import periodic_motion, repeats
from dynamics.steady.basins.regions import attracting_region
from dynamics.steady.basins.slipping_orbits import slipping_orbit
from dynamics.steady.basins.turning import RevolutionMap
from rig_basics.texts import number_of
from rig_basics.thread_pool import ThreadPool

Pair = tuple[float, float]

NOT_SETTLED = "not settled"
_FURTHER = 4  # additional time within which the end of a release must become evident, in units of its own time
_MIN_REVOLUTIONS, _MAX_REVOLUTIONS = 400, 4000  # bounds of that time
_RESTING = 0.1  # units of the state: change per revolution below which a motion may be close to a steady state
_RETRY_REVOLUTIONS = 40  # additional revolutions if Newton's method does not converge


@dataclass(frozen=True)
class ReleaseEnds:
    """End of one release of each rig; arrays of shape (n,).

    Attributes:
        name: "I", "II", "III", "one", "slipping", "not settled", or "refused".
        mirror: 0, or 1 for the second of two mirror images.
        theta_rad: mean angles of the state reached, shape (n, 2); NaN for the others.
        turns_per_revolution: rates of a slipping orbit, shape (n, 2); 0 at rest, NaN if not settled.
        multiplier: largest modulus over one revolution of the motion reached; NaN if not settled.
        caught_s, settled_s, amplitude_m: as in dynamics.steady.basins.following.FollowedReleases.
        sure: False at a boundary.
        refused: error messages by index of the rig.
    """

    name: NDArray[np.str_]
    mirror: Indices
    theta_rad: Array
    turns_per_revolution: Array
    multiplier: Array
    caught_s: Array
    settled_s: Array
    amplitude_m: Array
    sure: Flags
    refused: dict[int, str]


def release_ends(
    rigs: Sequence[RigOrParameters],
    speeds_rad_s: Sequence[float],
    from_rad: Pair | Sequence[Pair],
    seconds: float = 20.0,
    *,
    stated_error_rad: float = STATED_ERROR_RAD,
    workers: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> ReleaseEnds:
    """Compute the motion that a release of each rig reaches.

    Args:
        rigs, speeds_rad_s: one speed for each rig.
        from_rad: angles of A and B at the release, one pair for all or one for each.
        workers: number of threads. None: one per core.
        seconds, stated_error_rad, progress: as for dynamics.steady.basins.basin_map.basins.
    Raises:
        OutsideDomain: the counts do not match. Errors of single rigs are stored in `refused`.
    """
    count = len(rigs)
    starts = np.array(from_rad, np.float64)
    if starts.shape == (2,):
        starts = np.tile(starts, (count, 1))
    if len(speeds_rad_s) != count or starts.shape != (count, 2):
        raise OutsideDomain(
            f"{number_of(count, 'rig needs', 'rigs need')} as many speeds and pairs of angles, got "
            f"{len(speeds_rad_s)} and {starts.shape}"
        )
    found: list[_One | str] = [""] * count

    def one(i: int) -> _One | str:
        try:
            return _one(physics_of(rigs[i]), float(speeds_rad_s[i]), starts[i], seconds, stated_error_rad)
        except (DynamicsError, np.linalg.LinAlgError) as error:
            return str(error)

    with ThreadPool(workers or os.cpu_count() or 1) as pool:
        for i, each in enumerate(pool.map(one, range(count))):
            found[i] = each
            if progress is not None:
                progress((i + 1) / count)
    return _gathered(found)


@dataclass(frozen=True)
class _One:
    end: End | None
    caught_s: float
    settled_s: float
    amplitude_m: float
    sure: bool


def _one(p: RotorParameters, speed: float, from_rad: Array, seconds: float, stated_error_rad: float) -> _One:
    turning = RevolutionMap.of(p, speed)
    start = locked_state(p, speed, 0.0, float(from_rad[0]), float(from_rad[1]))
    blind = follow(turning, start[None, :], [], seconds, stated_error_rad=stated_error_rad, workers=1)
    end = end_ahead(turning, blind.last[0], seconds)
    if end is None:
        return _One(None, math.nan, math.nan, float(blind.amplitude_m[0]), bool(blind.sure[0]))
    found = follow(turning, start[None, :], [end], seconds, stated_error_rad=stated_error_rad, workers=1)
    return _One(
        end if found.end[0] == 0 else None,
        float(found.caught_s[0]),
        float(found.settled_s[0]),
        float(found.amplitude_m[0]),
        bool(found.sure[0]),
    )


def end_ahead(turning: RevolutionMap, state: Array, seconds: float) -> End | None:
    """The stable motion that a motion approaches, found by further simulation, or None."""
    horizon = min(_MAX_REVOLUTIONS, max(_MIN_REVOLUTIONS, math.ceil(_FURTHER * seconds / turning.period_s)))
    strobe, done = turning.strobed(state, _RETRY_REVOLUTIONS), 0
    while done < horizon:
        if repeats(turning, strobe, 1, _RESTING) is not None:
            end = _state_near(turning, strobe[-1])
            if end is not None:
                return end
        more = max(_RETRY_REVOLUTIONS, len(strobe) // 2)
        strobe = np.concatenate([strobe, turning.strobed(strobe[-1], more)[1:]])
        done += more
    orbit = slipping_orbit(turning, strobe[len(strobe) // 3 :], NEAR_RAD, quick=True)
    return None if orbit is None else with_slipping([], [orbit])[0]


def _state_near(turning: RevolutionMap, state: Array) -> End | None:
    """The stable steady state found by Newton's method near a state."""
    motion = periodic_motion(turning, state)
    if motion is None or not motion.stable:
        return None
    start = motion.states[0]
    region = attracting_region(turning, start, quick=True)
    if region is None:
        return None
    radius, a, b = turning.means(start)
    theta = (a % (2 * math.pi), b % (2 * math.pi))
    kind = kind_of(turning.parameters, theta)
    return End(kind, mirror_image(kind, theta), theta, radius, float(motion.moduli[0]), start, region)


def kind_of(p: RotorParameters, theta_rad: Pair) -> str:
    """Type of a steady state from its angles: I if nearest to balance, otherwise II (opposed) or III (together)."""
    if not (p.a.present and p.b.present):
        return "one"
    gap = abs((theta_rad[0] - theta_rad[1] + math.pi) % (2 * math.pi) - math.pi)
    aligned = {"III": gap, "II": math.pi - gap}
    here = np.exp(1j * np.array(theta_rad))
    balanced = [float(np.max(np.abs(here - np.exp(1j * np.array(angles))))) for angles in balanced_angles(p)]
    return "I" if min(balanced, default=math.inf) < min(aligned.values()) else min(aligned, key=lambda k: aligned[k])


def _gathered(found: Sequence[_One | str]) -> ReleaseEnds:
    number = len(found)
    names, mirror = np.full(number, NOT_SETTLED), np.zeros(number, np.int64)
    numbers, pairs = np.full((4, number), np.nan), np.full((2, number, 2), np.nan)
    sure, refused = np.zeros(number, np.bool_), dict[int, str]()
    for i, one in enumerate(found):
        if isinstance(one, str):
            names[i], refused[i] = "refused", one
            continue
        numbers[1:, i] = one.caught_s, one.settled_s, one.amplitude_m
        sure[i] = one.sure
        if one.end is not None:
            names[i], mirror[i], numbers[0, i] = one.end.name, one.end.mirror, one.end.multiplier
            pairs[0, i] = (math.nan, math.nan) if one.end.theta_rad is None else one.end.theta_rad
            pairs[1, i] = (0.0, 0.0) if one.end.slipping is None else one.end.slipping.turns_per_revolution
    multiplier, caught, settled, amplitude = numbers
    return ReleaseEnds(names, mirror, pairs[0], pairs[1], multiplier, caught, settled, amplitude, sure, refused)
