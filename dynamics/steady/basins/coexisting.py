"""All stable motions over a plane: steady states of every type, and slipping orbits continued to every neighbour."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from dynamics.arrays import Array
from dynamics.equations.parameters import RigOrParameters, physics_of
from dynamics.errors import DynamicsError, OutsideDomain
from dynamics.motions.locked_motion import locked_state
from dynamics.steady.basins.slipping_orbits import SlippingOrbit, continued, slipping_orbit
from dynamics.steady.basins.turning import RevolutionMap
from dynamics.steady.steady_motions import steady_states
from dynamics.steady.steady_state import SteadyState
from rig_basics.texts import number_of
from rig_basics.thread_pool import ThreadPool

_SCOUTS_RAD = ((0.0035, 3.1398), (1.5, 3.6), (3.0, 3.3))  # θ3, θ4 of releases that are simulated to find slipping
_FOLLOWED, _EVALUATED = 1500, 700  # revolutions simulated, and evaluated at the end
_FURTHER = 2500  # additional revolutions if a motion slips and its orbit is not found
_SAME_RATE = 1e-5  # turns per revolution: difference of rates below which two orbits are the same
_NEIGHBOUR_RATE = 0.2  # relative difference of rates below which an orbit counts as the continuation of a neighbour's


@dataclass(frozen=True)
class StableMotions:
    """Stable motions at one point.

    Attributes:
        steady: stable steady states.
        slipping: stable slipping orbits found by continuation of a neighbour's orbit or by releases.
        refused: error message, or "".
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
    rigs: Sequence[RigOrParameters],
    speeds_rad_s: Sequence[float],
    *,
    columns: int | None = None,
    workers: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> list[StableMotions]:
    """Compute all stable motions of each rig at its speed.

    Releases are simulated at every point. Each slipping orbit of a point is then continued to its four neighbours by
    Newton's method, from them to their neighbours, and so on, until no neighbour has a new orbit. An orbit that the few
    releases miss is therefore found if the plane leads to it. The result does not depend on the workers or their order.

    Args:
        rigs, speeds_rad_s: points of a grid, row by row, so close that an orbit can be continued to the next point.
        columns: number of points in a row of the grid. None: all points form one row.
        workers: number of threads. None: one per core.
        progress: called with the share of points at which releases have been simulated.
    Raises:
        OutsideDomain: the counts do not match. Errors of single rigs are stored in `refused`.
    """
    count = len(rigs)
    if len(speeds_rad_s) != count:
        raise OutsideDomain(f"{number_of(count, 'rig needs', 'rigs need')} as many speeds, got {len(speeds_rad_s)}")
    wide = columns or max(count, 1)
    if wide < 1 or count % wide:
        raise OutsideDomain(f"columns must divide the {number_of(count, 'point')}, got {columns!r}")
    done = 0

    def along(begin: int) -> list[StableMotions]:
        nonlocal done
        carried, found = list[SlippingOrbit](), list[StableMotions]()
        for rig, speed in zip(rigs[begin : begin + wide], speeds_rad_s[begin : begin + wide], strict=True):
            here = _at(rig, float(speed), carried)
            carried = list(here.slipping)
            found.append(here)
            done += 1
            if progress is not None:
                progress(done / count)
        return found

    with ThreadPool(workers or os.cpu_count() or 1) as pool:
        found = [each for part in pool.map(along, range(0, count, wide)) for each in part]
        _continue_to_neighbours(found, rigs, speeds_rad_s, wide, pool)
        return found


def _continue_to_neighbours(
    found: list[StableMotions],
    rigs: Sequence[RigOrParameters],
    speeds_rad_s: Sequence[float],
    wide: int,
    pool: ThreadPoolExecutor,
) -> None:
    """Add the slipping orbits of neighbours to each point, until no neighbour has a new one."""
    tried: list[list[SlippingOrbit]] = [[] for _ in found]
    while pairs := _to_try(found, tried, wide):
        places = [place for place, _ in pairs]
        new = pool.map(
            _with,
            (rigs[i] for i in places),
            (speeds_rad_s[i] for i in places),
            (found[i] for i in places),
            (orbits for _, orbits in pairs),
        )
        for place, here in zip(places, list(new), strict=True):
            found[place] = here


def _to_try(
    found: list[StableMotions], tried: list[list[SlippingOrbit]], wide: int
) -> list[tuple[int, list[SlippingOrbit]]]:
    """Points with orbits of their neighbours that are new and not yet tried there. The orbits are added to `tried`."""
    pairs = list[tuple[int, list[SlippingOrbit]]]()
    for place, here in enumerate(found):
        if here.refused:
            continue
        column, wanted = place % wide, list[SlippingOrbit]()
        for other, there in (
            (place - 1, column > 0),
            (place + 1, column < wide - 1),
            (place - wide, True),
            (place + wide, True),
        ):
            if not there or not 0 <= other < len(found):
                continue
            for orbit in found[other].slipping:
                rates = np.array(orbit.turns_per_revolution)
                near = _NEIGHBOUR_RATE * float(np.max(np.abs(rates)))
                if all(known is not orbit for known in tried[place]) and all(
                    _rate_apart(known, rates) >= near for known in here.slipping
                ):
                    wanted.append(orbit)
        if wanted:
            tried[place] += wanted
            pairs.append((place, wanted))
    return pairs


def _with(rig: RigOrParameters, speed: float, here: StableMotions, orbits: list[SlippingOrbit]) -> StableMotions:
    """Stable motions at a point, with those orbits of its neighbours that can be continued to it."""
    slipping = list(here.slipping)
    try:
        turning = RevolutionMap.of(rig, float(speed))
        for known in orbits:
            _add(slipping, continued(turning, known))
    except (DynamicsError, np.linalg.LinAlgError):  # usual: the neighbour's orbit does not exist at this point
        pass
    return replace(here, slipping=tuple(slipping))


def _at(rig: RigOrParameters, speed: float, carried: Sequence[SlippingOrbit]) -> StableMotions:
    try:
        turning = RevolutionMap.of(rig, speed)
        steady = tuple(s for s in steady_states(physics_of(rig), speed, 1e-6) if s.stable)
        orbits = list[SlippingOrbit]()
        for known in carried:
            _add(orbits, continued(turning, known))
        for a, b in _SCOUTS_RAD:
            strobe = turning.strobed(locked_state(turning.parameters, speed, 0.0, a, b), _FOLLOWED)[-_EVALUATED:]
            turned = np.abs(strobe[-1, 2:4] - strobe[0, 2:4]) / (2 * math.pi)
            rates = (strobe[-1, 2:4] - strobe[0, 2:4]) / (2 * math.pi * (len(strobe) - 1))
            if np.max(turned) < 2.0 or any(_rate_apart(o, rates) < 2.0 / len(strobe) for o in orbits):
                continue
            orbit = slipping_orbit(turning, strobe, None)
            if orbit is None and not orbits:
                orbit = slipping_orbit(turning, turning.strobed(strobe[-1], _FURTHER), None)
            _add(orbits, orbit)
        return StableMotions(steady, tuple(orbits))
    except (DynamicsError, np.linalg.LinAlgError) as error:
        return StableMotions(refused=str(error))


def _rate_apart(orbit: SlippingOrbit, rates: Array) -> float:
    return float(np.max(np.abs(np.array(orbit.turns_per_revolution) - rates)))


def _add(orbits: list[SlippingOrbit], found: SlippingOrbit | None) -> None:
    """Add an orbit if it is new."""
    if found is not None and all(
        _rate_apart(known, np.array(found.turns_per_revolution)) >= _SAME_RATE for known in orbits
    ):
        orbits.append(found)
