"""Probability of each end state of a release, from the uncertainties of the rig's numbers and the play of the locks."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from analysis.errors import AnalysisError
from dynamics import RotorParameters
from dynamics.errors import OutsideDomain
from dynamics.steady.basins.single import ReleaseEnds, release_ends
from rig_basics.arrays import Array
from rig_basics.tabular import Column, Tabular
from rig_basics.texts import number_of
from rig_configs import IdentifiedParameters

PLAY_RAD = math.radians(0.2)
LOCKED_RAD = (0.0, math.pi)
_MAX_DRAWS_PER_RIG = 200  # draws of the covariance for one possible set of numbers


@dataclass(frozen=True)
class EndProbability:
    """One end state and its frequency.

    Attributes:
        name: "I", "II", "III", "one", "slipping", "not settled" or "refused".
        mirror: 0, or 1 for the second of two mirror images.
        count: draws with this end state.
        probability: share of all draws.
        interval: Wilson's interval at the requested level.
    """

    name: str
    mirror: int
    count: int
    probability: float
    interval: tuple[float, float]


@dataclass(frozen=True)
class EndProbabilities(Tabular):
    """End states by probability, most probable first.

    Attributes:
        ends: end states; each mirror image of a balanced state is separate.
        draws: number of draws.
        level: confidence level of the intervals.
        unsure: draws at a boundary, whose end state changes within the stated error.
        releases: end of each release.
    """

    ends: tuple[EndProbability, ...]
    draws: int
    level: float
    unsure: int
    releases: ReleaseEnds

    @property
    def heading(self) -> str:
        """Number of draws, and of those at a boundary."""
        return f"EndProbabilities: {number_of(self.draws, 'draw')}, {self.unsure} at a boundary"

    def columns(self) -> Mapping[str, Column]:
        """Return a row for each end state."""
        names = "name", "mirror", "count", "probability"
        low, high = zip(*(end.interval for end in self.ends), strict=True)
        return {name: [getattr(end, name) for end in self.ends] for name in names} | {"low": low, "high": high}


def wilson_interval(count: int, draws: int, level: float = 0.95) -> tuple[float, float]:
    """Return Wilson's interval of a share.

    Raises:
        OutsideDomain: impossible counts or level.
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


@dataclass(frozen=True)
class ReleaseDraws:
    """Releases of a Monte Carlo.

    Attributes:
        draws: number of draws.
        seconds: duration of each release, s.
        play_rad: play of the locks to either side, uniform.
        from_rad: angles of A and B at the locks.
        level: confidence level of the intervals.
        seed: seed of the random numbers.
    Raises:
        OutsideDomain: no draw, or an impossible play.
    """

    draws: int
    seconds: float = 20.0
    play_rad: float = PLAY_RAD
    from_rad: tuple[float, float] = LOCKED_RAD
    level: float = 0.95
    seed: int = 1

    def __post_init__(self) -> None:
        if self.draws < 1 or not (0 <= self.play_rad < math.pi):
            raise OutsideDomain(
                f"expected at least one draw and a play from 0 to 180°, got {self.draws} and {self.play_rad!r}"
            )


def end_probabilities(
    physics: RotorParameters,
    speed_rad_s: float,
    known: IdentifiedParameters,
    releases: ReleaseDraws,
    progress: Callable[[float], None] | None = None,
) -> EndProbabilities:
    """Monte Carlo of releases: identified numbers by their covariance, release angles uniform within the locks' play.

    Args:
        physics: parameters of the rig with the identified values.
        known: values with their covariance; the suspension's terms, drag and bow are taken as exact.
        releases: number of draws, and the releases.
        progress: called with the completed share.
    Raises:
        OutsideDomain: impossible arguments.
        AnalysisError: hardly any draw of the covariance is a possible rig.

    Example:
        >>> import numpy as np
        >>> from analysis import ReleaseDraws, end_probabilities
        >>> from rig_configs import IdentifiedParameters, load_rig
        >>> known = IdentifiedParameters({"zeta1": 0.02}, np.array([[1e-3**2]]))
        >>> found = end_probabilities(load_rig("virtual").physics, 30.0, known, ReleaseDraws(2, seconds=30.0))
        >>> [(end.name, end.count) for end in found.ends]
        [('I', 2)]
    """
    draws, play_rad = releases.draws, releases.play_rad
    rng = np.random.default_rng(releases.seed)
    rigs = drawn_rigs(physics, known, draws, rng)
    starts = np.array(releases.from_rad) + rng.uniform(-play_rad, play_rad, (draws, 2))
    pairs = [(float(a), float(b)) for a, b in starts]
    found = release_ends(rigs, [speed_rad_s] * draws, pairs, releases.seconds, progress=progress)
    counts = Counter(zip(found.name.tolist(), found.mirror.tolist(), strict=True))
    ends = tuple(
        EndProbability(name, mirror, count, count / draws, wilson_interval(count, draws, releases.level))
        for (name, mirror), count in counts.most_common()
    )
    unsure = draws - int(np.count_nonzero(found.sure)) - len(found.refused)
    return EndProbabilities(ends, draws, releases.level, unsure, found)


def drawn_rigs(
    physics: RotorParameters, known: IdentifiedParameters, draws: int, rng: np.random.Generator
) -> list[RotorParameters]:
    """Draw rigs with identified numbers of a normal distribution. Impossible sets of numbers are drawn again.

    Raises:
        AnalysisError: hardly any draw is a possible rig.
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
        if tried > _MAX_DRAWS_PER_RIG * draws:
            raise AnalysisError(
                f"{len(rigs)} of {number_of(tried, 'draw')} from the covariance are possible rigs: the "
                f"covariance is too large"
            )
        drawn = middle + root @ rng.standard_normal(len(names))
        try:
            rigs.append(physics.with_values(**dict(zip(names, drawn.tolist(), strict=True))))
        except OutsideDomain:  # usual: not a possible rig; counted in `tried`
            continue
    return rigs
