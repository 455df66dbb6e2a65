"""Result of a pendulum transient with free dry friction, and joint estimate of damping and friction by several of them.

Friction that is too small to be found biases c by many times the standard deviation of a fit without friction.
Therefore every fit is extended at its end by the unknowns M_A, M_B (torque independent of the speed) and F_A, F_B
(torque F φ̇² by the contact force), and its search goes on from its minimum. These four unknowns are common to the
tests of a campaign: a flick at rest determines M but hardly F, releases at several speeds determine M + F ω². Together
they determine c nearly as well as without friction. Friction of any sign is allowed in a fit: bounds at 0 would bias c.
The torque is linear in c, M and F, so that χ² is nearly a parabola of them (in ln c it is a bent valley).
Source: docs/theory/pendulum_damping.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final, cast

import numpy as np
from scipy import optimize

from identification.errors import FitFailed
from rig_basics.arrays import Array
from rig_configs.known import KnownSource

_nnls = cast("Callable[[Array, Array], tuple[Array, float]]", cast("Any", optimize).nnls)  # scipy has no types

DAMPING, FRICTION = slice(0, 2), slice(2, 6)
TORQUE_STD_Nm: Final = 1e-2
CONTACT_STD_kg_m2: Final = 1e-4
"""Prior standard deviations larger than any bearing's friction, for finite variances of undetermined directions."""
_UNIT = np.array([1e-3, 1e-3, 1e-6, 1e-6, 1e-9, 1e-9])
_INSIDE = 1.96**2  # χ² of a 95 % interval
_MIN_EIGENVALUE = 1e-12  # smallest eigenvalue of a correlation matrix
_FURTHEST = 40.0  # largest half-width of an interval in standard deviations of c with free friction


def whitener(matrix: Array) -> Array:
    """Return W with WᵀW equal to the inverse of a positive definite matrix; directions lost by rounding stay finite."""
    unit = np.sqrt(np.maximum(np.abs(np.diag(matrix)), 1e-200))
    sizes, turn = np.linalg.eigh(0.5 * (matrix + matrix.T) / np.outer(unit, unit))
    return (turn / np.sqrt(np.maximum(sizes, _MIN_EIGENVALUE))).T / unit


def inverse(matrix: Array) -> Array:
    """Return the symmetric inverse of a positive definite matrix."""
    w = whitener(matrix)
    return w.T @ w


@dataclass(frozen=True)
class OpenFriction:
    """Estimate of damping and friction by one transient.

    Attributes:
        values: c3, c4 (N m s/rad), M_A, M_B (N m), F_A, F_B (kg m²), shape (6,), of any sign.
        covariance: covariance of the values, shape (6, 6).
        by_number: known number → derivative of the values by it, shape (6,).
    """

    values: Array
    covariance: Array
    by_number: Mapping[str, Array] = field(default_factory=dict[str, Array])

    @classmethod
    def of_torque_at(cls, values: Array, covariance: Array, speed2: float) -> OpenFriction:
        """Create the result of a test that determines only M + F ω².

        Args:
            values: as in the class, with any split between M and F.
            covariance: covariance of c3, c4 and both torques at the speed, shape (4, 4).
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
        """Return the derivative of the values by a known number, shape (6,); 0 for an unknown name."""
        return self.by_number.get(number, np.zeros(6))

    def knowing(self, std: Mapping[str, float]) -> OpenFriction:
        """Return the result with a covariance without the part of some known numbers.

        Args:
            std: number → standard uncertainty in the fit.
        """
        covariance = self.covariance.copy()
        for number, deviation in std.items():
            shift = deviation * self.slope(number)
            covariance -= np.outer(shift, shift)
        return replace(self, covariance=covariance)

    def without_contact_information(self) -> OpenFriction:
        """Return the result without information on F, for a spin-down whose F may be the air's drag."""
        covariance = self.covariance.copy()
        covariance[4:], covariance[:, 4:] = 0.0, 0.0
        covariance[[4, 5], [4, 5]] = CONTACT_STD_kg_m2**2
        return replace(self, values=np.r_[self.values[:4], 0.0, 0.0], covariance=covariance)

    def covering(self, sources: Sequence[KnownSource]) -> OpenFriction:
        """Return the result with the uncertainty of known numbers added to its covariance."""
        covariance = self.covariance.copy()
        for shift in self._shifts(sources):
            covariance += np.outer(shift, shift)
        return replace(self, covariance=covariance)

    def _shifts(self, sources: Sequence[KnownSource]) -> Array:
        """Return the shifts of the values for one standard deviation of each source, shape (k, 6)."""
        parts = [sum((self.slope(n) * step for n, step in s.effects.items()), np.zeros(6)) for s in sources]
        return np.array(parts).reshape(len(sources), 6)

    def loadings(self, sources: Sequence[KnownSource]) -> Array:
        """Return the shifts of the values for one standard deviation of each of k sources.

        Returns:
            Shape (6, k), in units of 1e-3 N m s/rad, 1e-6 N m and 1e-9 kg m², two of each.
        """
        return (self._shifts(sources) / _UNIT).T

    def widened(self, damping: Array) -> OpenFriction:
        """Return the result with an additional covariance of c3, c4, shape (2, 2)."""
        covariance = self.covariance.copy()
        covariance[DAMPING, DAMPING] += damping
        return replace(self, covariance=covariance)

    def information(self) -> Array:
        """Return the inverse covariance in the units of `loadings`, shape (6, 6)."""
        return inverse(self.covariance / np.outer(_UNIT, _UNIT))

    def given(self, friction: Array) -> tuple[Array, Array]:
        """Return c3, c4 (2,) and their covariance (2, 2) for known M_A, M_B, F_A, F_B, shape (4,)."""
        information, unit = self.information(), _UNIT[DAMPING]
        own = inverse(information[DAMPING, DAMPING])
        away = (friction - self.values[FRICTION]) / _UNIT[FRICTION]
        found = self.values[DAMPING] - unit * (own @ information[DAMPING, FRICTION] @ away)
        return found, own * np.outer(unit, unit)


@dataclass(frozen=True)
class Alone:
    """Damping by one transient with free friction of any sign.

    Attributes:
        damping: c3, c4, N m s/rad, shape (2,).
        covariance: covariance of these, shape (2, 2).
        known_std: standard deviations for known friction, shape (2,).
        torque_Nm, contact_kg_m2: upper 95 % limits of the friction of A and B, shape (2,).
    """

    damping: Array
    covariance: Array
    known_std: Array
    torque_Nm: Array
    contact_kg_m2: Array


@dataclass(frozen=True)
class Together:
    """Joint estimate of the friction by several transients.

    Attributes:
        friction, covariance: M_A, M_B, F_A, F_B and their covariance with the known numbers' uncertainty, shapes (4,),
            (4, 4).
        damping: c3, c4 of each test with this friction, N m s/rad, shape (2,) each.
        own: covariance of these for known friction, shape (2, 2) each.
        shared: shifts of each test's c3, c4 for one standard deviation of each independent part of the friction's
            error, shape (2, 4) each.
        by_number: known number → derivative of each test's c3, c4 by it, shape (2,) each.
    """

    friction: Array
    covariance: Array
    damping: list[Array]
    own: list[Array]
    shared: list[Array]
    by_number: list[dict[str, Array]]


def alone(one: OpenFriction) -> Alone:
    """Return the damping by one transient, and limits of its friction.

    The friction may have any sign, so that the estimate of c is unbiased for every friction of at least 0. With bounds
    at 0 friction that does not exist has a positive error only, and c, which has the opposite error, was low by 0.4
    standard deviations on average. The limits of the friction are those of the profile likelihood over friction of at
    least 0.
    """
    _, known = one.given(np.zeros(4))
    limits = np.zeros(4)
    for k in range(4):
        at = [2 + (k + j) % 4 for j in range(4)]
        unit = _UNIT[at]
        _, _, limits[k] = profile(one.values[at] / unit, one.covariance[np.ix_(at, at)] / np.outer(unit, unit), 1)
    limits = np.maximum(limits, 0.0) * _UNIT[FRICTION]
    own = one.covariance[DAMPING, DAMPING]
    return Alone(one.values[DAMPING], own, np.sqrt(np.diag(known)), limits[:2], limits[2:])


def profile(mean: Array, covariance: Array, least: int) -> tuple[float, float, float]:
    """Return the most likely value of the first unknown and its 95 % interval; the other unknowns are at least 0.

    Args:
        mean: estimates, shape (n,).
        covariance: covariance of the estimates, shape (n, n).
        least: 1 if the most likely value of the first unknown is also at least 0, else 0.
    """
    spread = np.sqrt(covariance[0, 0])
    slope = covariance[1:, 0] / covariance[0, 0]
    left = covariance[1:, 1:] - np.outer(slope, covariance[0, 1:])
    root = whitener(left)

    def excess(value: float) -> float:
        wanted = mean[1:] + slope * (value - mean[0])
        return ((value - mean[0]) / spread) ** 2 + _nnls(root, root @ wanted)[1] ** 2

    whole = whitener(covariance)
    # a value of any sign is the difference of two values of at least 0
    design = whole if least else np.column_stack([whole, -whole[:, 0]])
    found, left_over = _nnls(design, whole @ mean)
    best, lowest = float(found[0] - (0.0 if least else found[-1])), left_over**2
    reach: list[float] = []
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
    """Return damping and friction by several tests, or by stretches of one, with generalised least squares.

    Args:
        tests: results of the tests, whose covariances do not contain the sources.
        sources: sources of uncertainty in the known numbers, common to all tests. They reduce the weight of a test
            whose result depends on a mass, and prevent differences by a mass from counting as friction. The covariance
            of the result does not contain them.
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
    """Return the joint friction of all tests, and each test's damping with it.

    Without sources, the sum of the dampings weighted by their own covariances, with the shared parts added, is exactly
    the least-squares solution for damping and friction together.

    Args:
        tests: results of the tests.
        trusted: indices of the tests that determine the friction; None for all.
        sources: sources of uncertainty in the known numbers, common to all tests.
    """
    whole = pooled(tests if trusted is None else [tests[i] for i in trusted], sources)
    unit = _UNIT[FRICTION]
    spread = whole.covariance[FRICTION, FRICTION] / np.outer(unit, unit)
    sizes, turn = np.linalg.eigh(spread)
    parts = turn * np.sqrt(np.maximum(sizes, 0.0))
    total = whole.covering(sources).covariance[FRICTION, FRICTION]
    out = Together(whole.values[FRICTION], total, [], [], [], [])
    for test in tests:
        damping, own = test.given(whole.values[FRICTION])
        out.own.append(own)
        out.damping.append(damping)
        out.shared.append(np.array([test.given(at)[0] - damping for at in whole.values[FRICTION] + (parts.T * unit)]).T)
        # with the joint friction the damping depends on a number directly and through that friction
        moved = {n: replace(test, values=test.slope(n)).given(whole.slope(n)[FRICTION])[0] for n in whole.by_number}
        out.by_number.append(moved)
    return out
