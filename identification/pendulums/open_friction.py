"""A pendulum transient with its dry friction left open, and what several of them say of damping and friction together.

A friction too small to be found biases c by many times the standard deviation of a fit that goes without. So every fit
is asked once more at its end, with M_A, M_B (a torque at any speed) and F_A, F_B (with the contact force, F φ̇²) as
unknowns beside ln c3, ln c4: one Gauss–Newton step from where it stands. Tests of one campaign have these four in
common: a flick at rest shows M and hardly F, releases at several speeds show M + F ω². Together they leave c nearly as
well known as without friction. A test that stands alone takes what M ≥ 0 and F ≥ 0 leave. Source:
docs/theory/pendulum_damping.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from identification.errors import FitFailed
from rig_configs.known import KnownSource

Array = NDArray[np.float64]

DAMPING, FRICTION = slice(0, 2), slice(2, 6)
TORQUE_STD_Nm, CONTACT_STD_kg_m2 = 1e-2, 1e-4
"""Beyond any bearing: keeps directions finite that a test does not show."""
_UNIT = np.array([1.0, 1.0, 1e-6, 1e-6, 1e-9, 1e-9])
_INSIDE = 1.96**2  # χ² of a 95 % interval
_SOUND = 1e-12  # least eigenvalue of a correlation
_SURELY = 20.0  # χ² of four frictions that chance exceeds once in 2000
_FURTHEST = 40.0  # standard deviations of ln c with all friction open


def whitener(matrix: Array) -> Array:
    """W with WᵀW the inverse of a positive matrix of any scales; directions that rounding has lost are kept finite."""
    unit = np.sqrt(np.maximum(np.abs(np.diag(matrix)), 1e-200))
    sizes, turn = np.linalg.eigh(0.5 * (matrix + matrix.T) / np.outer(unit, unit))
    return (turn / np.sqrt(np.maximum(sizes, _SOUND))).T / unit


def inverse(matrix: Array) -> Array:
    """Its inverse, symmetric."""
    w = whitener(matrix)
    return w.T @ w


@dataclass(frozen=True)
class OpenFriction:
    """What one transient says of damping and friction.

    Attributes:
        values: ln c3, ln c4, M_A, M_B (N m), F_A, F_B (kg m²), shape (6,); friction of any sign.
        covariance: shape (6, 6).
        by_number: known number → derivative of the values by it, shape (6,).
    """

    values: Array
    covariance: Array
    by_number: Mapping[str, Array] = field(default_factory=dict[str, Array])

    @classmethod
    def of_torque_at(cls, values: Array, covariance: Array, speed2: float) -> OpenFriction:
        """Of a test that shows M + F ω² alone.

        Args:
            values: as above, of any split between M and F.
            covariance: of ln c3, ln c4 and both torques at the speed, shape (4, 4).
            speed2: ω², (rad/s)².
        """
        design = np.zeros((4, 6))
        design[[0, 1, 2, 3], [0, 1, 2, 3]] = 1.0
        design[[2, 3], [4, 5]] = speed2
        design = design * _UNIT / _UNIT[:4, None]
        prior = np.r_[np.zeros(2), np.repeat([TORQUE_STD_Nm, CONTACT_STD_kg_m2], 2) ** -2.0] * _UNIT**2
        shown = inverse(covariance / np.outer(_UNIT[:4], _UNIT[:4]))
        return cls(values, inverse(design.T @ shown @ design + np.diag(prior)) * np.outer(_UNIT, _UNIT))

    def __post_init__(self) -> None:
        if not (np.all(np.isfinite(self.covariance)) and np.all(np.isfinite(self.values))):
            raise FitFailed("damping and friction have no finite covariance; record the test again")

    def slope(self, number: str) -> Array:
        """Derivative of the values by a known number, shape (6,); 0 where there is none."""
        return self.by_number.get(number, np.zeros(6))

    def knowing(self, std: Mapping[str, float]) -> OpenFriction:
        """The same without what the uncertainty of some known numbers has brought into its covariance.

        Args:
            std: standard uncertainty of each of these numbers, as the fit took it.
        """
        covariance = self.covariance.copy()
        for number, deviation in std.items():
            shift = deviation * self.slope(number)
            covariance -= np.outer(shift, shift)
        return replace(self, covariance=covariance)

    def beside_drag(self) -> OpenFriction:
        """What a spin-down says where F may as well be the air's drag: of F nothing, of the rest as much less."""
        covariance = self.covariance.copy()
        covariance[4:], covariance[:, 4:] = 0.0, 0.0
        covariance[[4, 5], [4, 5]] = CONTACT_STD_kg_m2**2
        return replace(self, values=np.r_[self.values[:4], 0.0, 0.0], covariance=covariance)

    def covering(self, sources: Sequence[KnownSource]) -> OpenFriction:
        """The same with the uncertainty of what is taken as known in its covariance."""
        covariance = self.covariance.copy()
        for shift in self._shifts(sources):
            covariance += np.outer(shift, shift)
        return replace(self, covariance=covariance)

    def _shifts(self, sources: Sequence[KnownSource]) -> Array:
        """The values' shift for one standard deviation of each source, shape (k, 6)."""
        parts = [sum((self.slope(n) * step for n, step in s.effects.items()), np.zeros(6)) for s in sources]
        return np.array(parts).reshape(len(sources), 6)

    def loadings(self, sources: Sequence[KnownSource]) -> Array:
        """The same in units of (1, 1, 1e-6 N m twice, 1e-9 kg m² twice), shape (6, k)."""
        return (self._shifts(sources) / _UNIT).T

    def widened(self, log_damping: Array) -> OpenFriction:
        """The same with more covariance of ln c3, ln c4, shape (2, 2)."""
        covariance = self.covariance.copy()
        covariance[DAMPING, DAMPING] += log_damping
        return replace(self, covariance=covariance)

    def information(self) -> Array:
        """Inverse covariance in units of (1, 1, 1e-6 N m twice, 1e-9 kg m² twice), shape (6, 6)."""
        return inverse(self.covariance / np.outer(_UNIT, _UNIT))

    def given(self, friction: Array) -> tuple[Array, Array]:
        """ln c3, ln c4 (2,) and their covariance (2, 2) were M_A, M_B, F_A, F_B known, shape (4,)."""
        information = self.information()
        own = inverse(information[DAMPING, DAMPING])
        away = (friction - self.values[FRICTION]) / _UNIT[FRICTION]
        return self.values[DAMPING] - own @ information[DAMPING, FRICTION] @ away, own


@dataclass(frozen=True)
class Alone:
    """Damping by one transient, friction not below zero.

    Attributes:
        log_damping: the most likely ln c3, ln c4, shape (2,).
        below, above: how far their 95 % intervals reach, shape (2,).
        covariance: Gaussian that reaches as far as the longer side, shape (2, 2).
        known_std: what the standard deviations were if the friction were known, shape (2,).
        torque_Nm, contact_kg_m2: of A and B, the 95 % limits from above, shape (2,).
    """

    log_damping: Array
    below: Array
    above: Array
    covariance: Array
    known_std: Array
    torque_Nm: Array
    contact_kg_m2: Array


@dataclass(frozen=True)
class Together:
    """What several transients say of the friction that they share.

    Attributes:
        friction, covariance: M_A, M_B, F_A, F_B, shapes (4,), (4, 4), with the known numbers' uncertainty.
        log_damping: ln c3, ln c4 by each test with this friction, shape (2,) each.
        own: their covariances were the friction known, shape (2, 2) each.
        shared: shifts of each test's ln c3, ln c4 for one standard deviation of each independent part of the friction's
            error, shape (2, 4) each.
        by_number: known number → derivative of each test's ln c3, ln c4 by it, shape (2,) each.
    """

    friction: Array
    covariance: Array
    log_damping: list[Array]
    own: list[Array]
    shared: list[Array]
    by_number: list[dict[str, Array]]


def alone(one: OpenFriction) -> Alone:
    """The profile likelihood of c3 and of c4 over friction not below zero.

    Where the readings ask for less friction than none, the interval is that of a fit without; where they ask for some,
    or cannot exclude it, it reaches as far as that friction takes it. Beside a boundary a profile alone covers 90 %:
    unless friction is surely there, the interval holds that of a fit without, too.
    """
    best, below, above = np.zeros(2), np.zeros(2), np.zeros(2)
    none, known = one.given(np.zeros(4))
    for k in range(2):
        at = [k, 2, 3, 4, 5]
        unit = _UNIT[at]
        best[k], low, high = profile(one.values[at] / unit, one.covariance[np.ix_(at, at)] / np.outer(unit, unit), 0)
        if not _excluded(one):
            reach = 1.96 * np.sqrt(known[k, k])
            low, high = min(low, none[k] - reach), max(high, none[k] + reach)
        below[k], above[k] = best[k] - low, high - best[k]
    std = np.maximum(below, above) / 1.96
    spread = np.sqrt(np.diag(one.covariance)[DAMPING])
    correlation = one.covariance[DAMPING, DAMPING] / np.outer(spread, spread)
    limits = np.zeros(4)
    for k in range(4):
        at = [2 + (k + j) % 4 for j in range(4)]
        unit = _UNIT[at]
        _, _, limits[k] = profile(one.values[at] / unit, one.covariance[np.ix_(at, at)] / np.outer(unit, unit), 1)
    limits = np.maximum(limits, 0.0) * _UNIT[FRICTION]
    return Alone(best, below, above, correlation * np.outer(std, std), np.sqrt(np.diag(known)), limits[:2], limits[2:])


def _excluded(one: OpenFriction) -> bool:
    """Whether there surely is friction."""
    unit = _UNIT[FRICTION]
    friction = one.values[FRICTION] / unit
    inner = one.covariance[FRICTION, FRICTION] / np.outer(unit, unit)
    return bool(friction @ inverse(inner) @ friction > _SURELY)


def profile(mean: Array, covariance: Array, least: int) -> tuple[float, float, float]:
    """Most likely value of the first unknown and its 95 % interval, the others not below zero.

    Args:
        least: 1 where the first one's own most likely value is not below zero either.
    """
    spread = np.sqrt(covariance[0, 0])
    slope = covariance[1:, 0] / covariance[0, 0]
    left = covariance[1:, 1:] - np.outer(slope, covariance[0, 1:])
    root = whitener(left)

    def excess(value: float) -> float:
        wanted = mean[1:] + slope * (value - mean[0])
        return ((value - mean[0]) / spread) ** 2 + nnls(root, root @ wanted)[1] ** 2

    whole = whitener(covariance)
    # a value of any sign is the difference of two that are not below zero
    design = whole if least else np.column_stack([whole, -whole[:, 0]])
    found, left_over = nnls(design, whole @ mean)
    best, lowest = float(found[0] - (0.0 if least else found[-1])), left_over**2
    reach = []
    for side in (-1.0, 1.0):
        near, far = 0.0, spread
        while excess(best + side * far) - lowest < _INSIDE and far < _FURTHEST * spread:
            near, far = far, 2 * far
        for _ in range(40):
            middle = 0.5 * (near + far)
            near, far = (middle, far) if excess(best + side * middle) - lowest < _INSIDE else (near, middle)
        reach.append(best + side * far)
    return best, reach[0], reach[1]


def pooled(tests: Sequence[OpenFriction], sources: Sequence[KnownSource] = ()) -> OpenFriction:
    """Damping and friction by several tests, or stretches of one: generalised least squares.

    Args:
        sources: of uncertainty in what all tests take as known. A test whose answer hangs on a mass weighs less, and
            what tests disagree in because of a mass is no friction. The covariance is without them, as each test's is.
    """
    k = len(sources)
    whole, rows = np.zeros((6 + k, 6 + k)), list[Array]()
    whole[6:, 6:] = np.eye(k)
    for test in tests:  # x = z − loadings · errors + noise
        design = np.hstack([np.eye(6), -test.loadings(sources)])
        rows.append(design.T @ test.information())
        whole += rows[-1] @ design
    pulls = [(inverse(whole) @ row)[:6] / _UNIT for row in rows]

    def joint(each: Sequence[Array]) -> Array:
        return _UNIT * sum((pull @ v for pull, v in zip(pulls, each, strict=True)), np.zeros(6))

    own = sum((pull @ t.covariance @ pull.T for pull, t in zip(pulls, tests, strict=True)), np.zeros((6, 6)))
    return OpenFriction(
        joint([t.values for t in tests]),
        own * np.outer(_UNIT, _UNIT),
        {name: joint([t.slope(name) for t in tests]) for name in dict.fromkeys(n for t in tests for n in t.by_number)},
    )


def together(
    tests: Sequence[OpenFriction], trusted: Sequence[int] | None = None, sources: Sequence[KnownSource] = ()
) -> Together:
    """All tests' friction as one, and each test's damping with it.

    Args:
        trusted: those that say what the friction is; all of them where it is not given.
        sources: of uncertainty in what all tests take as known.

    Without sources, weighted sums of the damping, each test by its own covariance, and the shared parts added, are
    then exactly the least squares over damping and friction together.
    """
    whole = pooled(tests if trusted is None else [tests[i] for i in trusted], sources)
    unit = _UNIT[FRICTION]
    spread = whole.covariance[FRICTION, FRICTION] / np.outer(unit, unit)
    sizes, turn = np.linalg.eigh(spread)
    parts = turn * np.sqrt(np.maximum(sizes, 0.0))
    total = whole.covering(sources).covariance[FRICTION, FRICTION]
    out = Together(whole.values[FRICTION], total, [], [], [], [])
    for test in tests:
        log_damping, own = test.given(whole.values[FRICTION])
        out.own.append(own)
        out.log_damping.append(log_damping)
        out.shared.append(-own @ test.information()[DAMPING, FRICTION] @ parts)
        # damping with the friction that all have found goes with a number directly and by that friction
        moved = {n: replace(test, values=test.slope(n)).given(whole.slope(n)[FRICTION])[0] for n in whole.by_number}
        out.by_number.append(moved)
    return out
