# pyright: strict
"""All stable motions of many rigs and speeds: steady states of every type, and slipping orbits from point to point."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from dynamics.equations.parameters import RotorParameters, physics_of
from dynamics.errors import DynamicsError, OutsideDomain
from dynamics.motions.locked_motion import locked_state
from dynamics.steady.basins.slipping_orbits import SlippingOrbit, continued, slipping_orbit
from dynamics.steady.basins.turning import Turning
from dynamics.steady.steady_motions import steady_states
from dynamics.steady.steady_state import SteadyState

_SCOUTS_RAD = ((0.0035, 3.1398), (1.5, 3.6), (3.0, 3.3))  # releases that are followed to see whether they slip
_FOLLOWED, _LOOKED_AT = 1500, 700  # revolutions
_SAME_RATE = 1e-5  # turns per revolution


@dataclass(frozen=True)
class StableMotions:
    """What is stable at one point.

    Attributes:
        steady: stable steady states.
        slipping: stable slipping orbits that were found: from the point before by Newton's method, else by releases.
        refused: why there is no answer; "" where there is one.
    """

    steady: tuple[SteadyState, ...] = ()
    slipping: tuple[SlippingOrbit, ...] = ()
    refused: str = ""

    @property
    def names(self) -> tuple[str, ...]:
        """Types that coexist, each once, in the order I, II, III, one, slipping."""
        there = {state.type for state in self.steady} | ({"slipping"} if self.slipping else set[str]())
        return tuple(name for name in ("I", "II", "III", "one", "slipping") if name in there)


def stable_motions(
    rigs: Sequence[RotorParameters | object],
    speeds_rad_s: Sequence[float],
    *,
    row: int | None = None,
    workers: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> list[StableMotions]:
    """All stable motions of each rig at its speed.

    Args:
        rigs, speeds_rad_s: neighbours follow one another, so that a slipping orbit is found from the one before.
        row: points in a row of a plane: within it orbits are carried on; None: all are one row.
        workers: threads; None: one a core.
        progress: called with the share done.
    Raises:
        OutsideDomain: counts that do not match. What is wrong with one rig is in `refused`.
    """
    count = len(rigs)
    if len(speeds_rad_s) != count:
        raise OutsideDomain(f"{count} rigs need as many speeds, got {len(speeds_rad_s)}")
    if row is not None and row < 1:
        raise OutsideDomain(f"row must be at least 1, got {row!r}")
    length = row or max(count, 1)
    done = 0

    def along(begin: int) -> list[StableMotions]:
        nonlocal done
        carried, found = list[SlippingOrbit](), list[StableMotions]()
        for rig, speed in zip(rigs[begin : begin + length], speeds_rad_s[begin : begin + length], strict=True):
            here = _at(rig, float(speed), carried)
            carried = list(here.slipping)
            found.append(here)
            done += 1
            if progress is not None:
                progress(done / count)
        return found

    with ThreadPoolExecutor(workers or os.cpu_count() or 1) as pool:
        try:
            return [each for part in pool.map(along, range(0, count, length)) for each in part]
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _at(rig: RotorParameters | object, speed: float, carried: Sequence[SlippingOrbit]) -> StableMotions:
    try:
        turning = Turning.of(rig, speed)
        steady = tuple(s for s in steady_states(physics_of(rig), speed, 1e-6) if s.stable)
        orbits = list[SlippingOrbit]()
        for known in carried:
            _add(orbits, continued(turning, known))
        for a, b in _SCOUTS_RAD:
            strobe = turning.strobed(locked_state(turning.parameters, speed, 0.0, a, b), _FOLLOWED)[-_LOOKED_AT:]
            turned = np.abs(strobe[-1, 2:4] - strobe[0, 2:4]) / (2 * math.pi)
            rates = (strobe[-1, 2:4] - strobe[0, 2:4]) / (2 * math.pi * (len(strobe) - 1))
            if np.max(turned) < 2.0 or any(_rate_apart(o, rates) < 2.0 / len(strobe) for o in orbits):
                continue
            _add(orbits, slipping_orbit(turning, strobe, None))
        return StableMotions(steady, tuple(orbits))
    except (DynamicsError, np.linalg.LinAlgError) as error:
        return StableMotions(refused=str(error))


def _rate_apart(orbit: SlippingOrbit, rates: np.ndarray) -> float:
    return float(np.max(np.abs(np.array(orbit.turns_per_revolution) - rates)))


def _add(orbits: list[SlippingOrbit], found: SlippingOrbit | None) -> None:
    """Keep an orbit that is none of those known."""
    if found is not None and all(
        _rate_apart(known, np.array(found.turns_per_revolution)) >= _SAME_RATE for known in orbits
    ):
        orbits.append(found)
