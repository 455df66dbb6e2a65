"""Dry friction in addition to viscous damping: result of a fit, and score test for further friction terms.

The torque against a pendulum's motion is c θ̇ + sign(θ̇) (M + F φ̇²). M is independent of the speed; F φ̇² is proportional
to the contact force M_i R φ̇². On a rotor at rest φ̇ = θ̇, so F acts as a drag proportional to the square of the speed. On
a turning rotor φ̇ ≈ ω, and a release determines M + F ω². Source: docs/theory/pendulum_damping.md.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import chdtri

from identification.least_squares import Minimum
from identification.pendulums.open_friction import FRICTION, OpenFriction
from identification.samples import correlation_inflation
from rig_configs.known import KEPT_FRICTION

CHANCE = 5e-4  # probability of a false detection of friction
_FEW_DRAWS = 40
_SIGNIFICANT_STD = 3.5  # standard deviations above which friction counts as found


@dataclass(frozen=True)
class Friction:
    """Dry friction of both pendulums.

    Attributes:
        torque_Nm, torque_std_Nm: M of A and B, and its standard deviation.
        contact_kg_m2, contact_std_kg_m2: F of A and B, the torque per φ̇², and its standard deviation.
        speed_rad_s: rotor speed in the test.
    """

    torque_Nm: tuple[float, float]
    torque_std_Nm: tuple[float, float]
    contact_kg_m2: tuple[float, float] = (0.0, 0.0)
    contact_std_kg_m2: tuple[float, float] = (0.0, 0.0)
    speed_rad_s: float = 0.0

    @classmethod
    def sure(cls, found: OpenFriction) -> Friction | None:
        """Return the significant friction of tests with free friction; None if no friction is significant.

        Args:
            found: result of the tests, with the uncertainty of the known numbers in its covariance.
        """
        values, std = found.values[2:], np.sqrt(np.diag(found.covariance)[2:])
        if not np.any(values > _SIGNIFICANT_STD * std):
            return None
        (ma, mb, fa, fb), (sma, smb, sfa, sfb) = values.tolist(), std.tolist()
        return cls((ma, mb), (sma, smb), (fa, fb), (sfa, sfb))

    @property
    def values(self) -> dict[str, float]:
        """Estimated values by name: coulomb_a_Nm, coulomb_b_Nm, contact_a_kg_m2, contact_b_kg_m2."""
        return {n: v for n, v, std in self._rows() if std > 0}

    @property
    def std(self) -> dict[str, float]:
        """Standard deviations of the values by name."""
        return {n: std for n, _, std in self._rows() if std > 0}

    def _rows(self) -> list[tuple[str, float, float]]:
        values, std = self.torque_Nm + self.contact_kg_m2, self.torque_std_Nm + self.contact_std_kg_m2
        return list(zip(KEPT_FRICTION, values, std, strict=True))

    @property
    def without_contact(self) -> Friction | None:
        """Friction with the torque that is independent of the speed only; None if it has none."""
        found = replace(self, contact_kg_m2=(0.0, 0.0), contact_std_kg_m2=(0.0, 0.0))
        return found if found.values else None

    def torque_at(self, speed_rad_s: float) -> np.ndarray:
        """Return M + F ω² of A and B at a rotor speed, at least 0, N m, shape (2,)."""
        return np.maximum(np.array(self.torque_Nm) + np.array(self.contact_kg_m2) * speed_rad_s**2, 0.0)

    def sure_torque_at(self, speed_rad_s: float) -> np.ndarray:
        """Return M + F ω² with terms of less than three standard deviations set to 0, N m, shape (2,)."""
        torque, contact = (
            np.where(np.array(v) > 3 * np.array(std), np.array(v), 0.0)
            for v, std in ((self.torque_Nm, self.torque_std_Nm), (self.contact_kg_m2, self.contact_std_kg_m2))
        )
        return torque + contact * speed_rad_s**2

    def sentence(self, label: str) -> str:
        """Return a sentence with the friction and its 95 % intervals.

        Args:
            label: name of the test.
        """
        parts: list[str] = []
        for name, unit, at in (("dry friction", "N m", 0), ("drag with the square of the speed", "kg m²", 2)):
            rows = self._rows()[at : at + 2]
            if any(std > 0 for _, _, std in rows):
                each = " and ".join(f"{v:.3g} ± {1.96 * s:.2g}" for _, v, s in rows)
                parts.append(f"{name} of {each} {unit} (A and B, 95 %)")
        return f"{label}: {' and '.join(parts)} acts in addition to viscous damping and is in the fit"


def kept_friction(found: Friction | None, whole: OpenFriction | None) -> dict[str, Any]:
    """Return dry friction for parameters.toml by its key; empty if none was found.

    The stored values are those of KEPT_FRICTION. If only one test determines them, a value that was not fitted is
    stored as 0 with a variance of 0. On a rotor at rest the air's drag has the same effect as contact friction. Contact
    friction from such a test is therefore stored as 0.

    Args:
        found: friction from the tests.
        whole: joint result of all tests, with the known numbers' uncertainty; None for fewer than two tests.
    """
    if found is None:
        return {}
    if whole is not None and Friction.sure(whole) is not None:
        values, covariance = whole.values[FRICTION], whole.covariance[FRICTION, FRICTION]
    else:
        turned = 1.0 if found.speed_rad_s > 0 else 0.0
        values = np.r_[found.torque_Nm, turned * np.array(found.contact_kg_m2)]
        covariance = np.diag(np.square(np.r_[found.torque_std_Nm, turned * np.array(found.contact_std_kg_m2)]))
    named = dict(zip(KEPT_FRICTION, values.tolist(), strict=True))
    return {"friction": {"values": named, "covariance": covariance.tolist()}}


@dataclass(frozen=True)
class Evidence:
    """Reduction of χ² by additional parameters, to first order.

    Attributes:
        gain: reduction of χ² over the mean reduction by chance per parameter.
        mended: reduction of χ².
        step: values of the parameters, shape (k,).
        limit: gain that chance exceeds with the probability CHANCE.
    """

    gain: float
    mended: float
    step: np.ndarray
    limit: float

    @property
    def found(self) -> bool:
        """Whether the reduction exceeds that by chance."""
        return self.gain > self.limit


def evidence(minimum: Minimum, columns: np.ndarray, rounding: np.ndarray | None, sizes: tuple[int, int]) -> Evidence:
    """Apply the score test to parameters that a fit did not have.

    Args:
        minimum: minimum of the fit without the parameters.
        columns: derivatives of the weighted data residual by the parameters, shape (n, k).
        rounding: errors by the encoders' rounding, in standard deviations, shape (draws, n). They are correlated near
            standstill, where chance reduces χ² by more than the χ² distribution with k degrees of freedom states.
        sizes: number of blocks of each encoder, n in total.
    """
    n, k = columns.shape
    whole = np.zeros((len(minimum.residual), k))
    whole[:n] = columns
    scale = np.sqrt(np.einsum("ij,ij->j", whole, whole)) + 1e-300
    known = minimum.jacobian / (np.sqrt(np.einsum("ij,ij->j", minimum.jacobian, minimum.jacobian)) + 1e-300)
    q, _ = np.linalg.qr(known)
    fresh = whole / scale
    fresh = fresh - q @ (q.T @ fresh)
    basis, sizes_of, turn = np.linalg.svd(fresh, full_matrices=False)
    seen = sizes_of > 1e-6
    basis = basis[:, seen]
    along = basis.T @ minimum.residual
    chance = max(1.0, float(minimum.residual[:n] @ minimum.residual[:n]) / max(1, n - 6 - k) - float(along @ along) / n)
    if rounding is not None:
        each = rounding[:_FEW_DRAWS] @ basis[:n]
        chance = max(chance, float(np.mean(each**2)))
    left = minimum.residual - basis @ along
    together = max(correlation_inflation(left[: sizes[0]]), correlation_inflation(left[sizes[0] : n]))
    step = -(turn[seen].T @ (along / sizes_of[seen])) / scale
    limit = float(chdtri(max(1, int(seen.sum())), CHANCE))
    mended = float(along @ along)
    return Evidence(mended / (chance * together**2), mended, step, limit)
