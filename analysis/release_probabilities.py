# pyright: strict
"""How probable each end of a release is, the rig's numbers and the locks' play being what they are."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from analysis.errors import AnalysisError
from dynamics import RotorParameters
from dynamics.errors import OutsideDomain
from dynamics.steady.basins.single import ReleaseEnds, release_ends
from rig_configs import IdentifiedParameters

Array = NDArray[np.float64]

PLAY_RAD = math.radians(0.2)
LOCKED_RAD = (0.0, math.pi)
_MOST_DRAWS = 200  # for one set of numbers that a rig can have


@dataclass(frozen=True)
class EndProbability:
    """One end and how often it came.

    Attributes:
        name: "I", "II", "III", "one", "slipping", "not settled" or "refused".
        mirror: 0, or 1 for the second of two mirror images.
        count: draws that ended there.
        probability: share of all draws.
        interval: Wilson's, at the level asked for.
    """

    name: str
    mirror: int
    count: int
    probability: float
    interval: tuple[float, float]


@dataclass(frozen=True)
class EndProbabilities:
    """Ends by probability, most probable first.

    Attributes:
        ends: each mirror image of a balanced state by itself.
        draws: how many there were.
        level: of the intervals.
        unsure: draws at a boundary: their own end hangs on less than the stated error.
        releases: what became of each.
    """

    ends: tuple[EndProbability, ...]
    draws: int
    level: float
    unsure: int
    releases: ReleaseEnds


def wilson_interval(count: int, draws: int, level: float = 0.95) -> tuple[float, float]:
    """Wilson's interval of a share.

    Raises:
        OutsideDomain: counts or a level that mean nothing.
    Source: E. B. Wilson, J. Am. Stat. Assoc. 22 (1927) 209-212: the shares p with |count/n − p| ≤ z sqrt(p(1 − p)/n).
    """
    if not (0 <= count <= draws and draws > 0 and 0 < level < 1):
        raise OutsideDomain(f"expected 0 ≤ count ≤ draws and a level within 0 … 1, got {count}, {draws}, {level!r}")
    z2 = NormalDist().inv_cdf(0.5 + 0.5 * level) ** 2
    share = count / draws
    middle = (share + z2 / (2 * draws)) / (1 + z2 / draws)
    half = math.sqrt(z2 * (share * (1 - share) / draws + z2 / (4 * draws**2))) / (1 + z2 / draws)
    low = 0.0 if count == 0 else max(0.0, middle - half)
    return low, 1.0 if count == draws else min(1.0, middle + half)


def end_probabilities(
    physics: RotorParameters,
    speed_rad_s: float,
    known: IdentifiedParameters,
    draws: int,
    *,
    seconds: float = 20.0,
    play_rad: float = PLAY_RAD,
    from_rad: tuple[float, float] = LOCKED_RAD,
    level: float = 0.95,
    seed: int = 1,
    progress: Callable[[float], None] | None = None,
) -> EndProbabilities:
    """Monte Carlo of releases: identified numbers by their covariance, the locks anywhere within their play.

    Args:
        physics: the rig with the identified values.
        known: values with their covariance; the suspension's terms, drag and bow are taken as they are.
        draws: how many.
        seconds: how long each release is followed.
        play_rad: of the locks to either side, evenly spread.
        from_rad: where the locks hold A and B.
        level: of the intervals.
        progress: called with the share done.
    Raises:
        OutsideDomain: numbers that mean nothing.
        AnalysisError: a covariance that leaves hardly any rig that can be.
    """
    if draws < 1 or not (0 <= play_rad < math.pi):
        raise OutsideDomain(f"expected at least one draw and a play from 0 to 180°, got {draws} and {play_rad!r}")
    rng = np.random.default_rng(seed)
    rigs = drawn_rigs(physics, known, draws, rng)
    starts = np.array(from_rad) + rng.uniform(-play_rad, play_rad, (draws, 2))
    pairs = [(float(a), float(b)) for a, b in starts]
    found = release_ends(rigs, [speed_rad_s] * draws, pairs, seconds, progress=progress)
    counts = Counter(zip(found.name.tolist(), found.mirror.tolist(), strict=True))
    ends = tuple(
        EndProbability(name, mirror, count, count / draws, wilson_interval(count, draws, level))
        for (name, mirror), count in counts.most_common()
    )
    unsure = draws - int(np.count_nonzero(found.sure)) - len(found.refused)
    return EndProbabilities(ends, draws, level, unsure, found)


def drawn_rigs(
    physics: RotorParameters, known: IdentifiedParameters, draws: int, rng: np.random.Generator
) -> list[RotorParameters]:
    """Rigs whose identified numbers are drawn from a normal distribution, those that no rig can have left out.

    Raises:
        AnalysisError: hardly any draw is a rig.
    """
    names = list(known.values)
    if not names:
        return [physics] * draws
    middle = np.array([known.values[name] for name in names])
    values, vectors = np.linalg.eigh(known.covariance)
    root: Array = vectors * np.sqrt(np.maximum(values, 0.0))
    rigs, tried = list[RotorParameters](), 0
    while len(rigs) < draws:
        tried += 1
        if tried > _MOST_DRAWS * draws:
            raise AnalysisError(
                f"{len(rigs)} of {tried} draws from the covariance are rigs that can be: it is too wide"
            )
        drawn = middle + root @ rng.standard_normal(len(names))
        try:
            rigs.append(physics.with_values(**dict(zip(names, drawn.tolist(), strict=True))))
        except OutsideDomain:
            continue
    return rigs
