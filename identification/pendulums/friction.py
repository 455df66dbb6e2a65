"""Dry friction beside the viscous damping: what of it a fit shows, and whether more of it would explain the readings.

The torque against a pendulum's motion is c θ̇ + sign(θ̇) (M + F φ̇²). M is there at any speed; F φ̇² goes with the
contact force M_i R φ̇². On a rotor at rest φ̇ = θ̇, so F shows as a drag that grows with the square of the speed; on a
rotor that turns φ̇ ≈ ω, and M + F ω² is what a release shows. Source: docs/theory/pendulum_damping.md.
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

CHANCE = 5e-4  # of friction being taken for real where there is none
_FEW_DRAWS = 40
_BEYOND_DOUBT = 3.5  # standard deviations


@dataclass(frozen=True)
class Friction:
    """Dry friction of both pendulums.

    Attributes:
        torque_Nm, torque_std_Nm: M of A and B.
        contact_kg_m2, contact_std_kg_m2: F of A and B, the torque per φ̇².
        speed_rad_s: of the rotor it was seen on.
    """

    torque_Nm: tuple[float, float]
    torque_std_Nm: tuple[float, float]
    contact_kg_m2: tuple[float, float] = (0.0, 0.0)
    contact_std_kg_m2: tuple[float, float] = (0.0, 0.0)
    speed_rad_s: float = 0.0

    @classmethod
    def sure(cls, found: OpenFriction) -> Friction | None:
        """What tests with open friction show beyond doubt; None where that is nothing.

        Args:
            found: with the uncertainty of the known numbers in its covariance.
        """
        values, std = found.values[2:], np.sqrt(np.diag(found.covariance)[2:])
        if not np.any(values > _BEYOND_DOUBT * std):
            return None
        (ma, mb, fa, fb), (sma, smb, sfa, sfb) = values.tolist(), std.tolist()
        return cls((ma, mb), (sma, smb), (fa, fb), (sfa, sfb))

    @property
    def values(self) -> dict[str, float]:
        """By name, what is not zero: coulomb_a_Nm, coulomb_b_Nm, contact_a_kg_m2, contact_b_kg_m2."""
        return {n: v for n, v, std in self._rows() if std > 0}

    @property
    def std(self) -> dict[str, float]:
        """Standard deviations of the values."""
        return {n: std for n, _, std in self._rows() if std > 0}

    def _rows(self) -> list[tuple[str, float, float]]:
        values, std = self.torque_Nm + self.contact_kg_m2, self.torque_std_Nm + self.contact_std_kg_m2
        return list(zip(KEPT_FRICTION, values, std, strict=True))

    @property
    def without_contact(self) -> Friction | None:
        """The torque that is there at any speed; None where there is none."""
        found = replace(self, contact_kg_m2=(0.0, 0.0), contact_std_kg_m2=(0.0, 0.0))
        return found if found.values else None

    def torque_at(self, speed_rad_s: float) -> np.ndarray:
        """M + F ω² of A and B on a rotor that turns at a speed, N m, shape (2,), not below 0."""
        return np.maximum(np.array(self.torque_Nm) + np.array(self.contact_kg_m2) * speed_rad_s**2, 0.0)

    def sure_torque_at(self, speed_rad_s: float) -> np.ndarray:
        """The same of what is more than three standard deviations from 0, the rest as 0; N m, shape (2,)."""
        torque, contact = (
            np.where(np.array(v) > 3 * np.array(std), np.array(v), 0.0)
            for v, std in ((self.torque_Nm, self.torque_std_Nm), (self.contact_kg_m2, self.contact_std_kg_m2))
        )
        return torque + contact * speed_rad_s**2

    def told(self, label: str) -> str:
        """A sentence for a reader, with 95 % intervals."""
        parts = []
        for name, unit, at in (("dry friction", "N m", 0), ("drag with the square of the speed", "kg m²", 2)):
            rows = self._rows()[at : at + 2]
            if any(std > 0 for _, _, std in rows):
                each = " and ".join(f"{v:.3g} ± {1.96 * s:.2g}" for _, v, s in rows)
                parts.append(f"{name} of {each} {unit} (A and B, 95 %)")
        return f"{label}: {' and '.join(parts)} acts beside the viscous damping and is in the fit"


def kept_friction(found: Friction | None, whole: OpenFriction | None) -> dict[str, Any]:
    """Dry friction for parameters.toml, by its key; nothing where none is found, 0 where that is no dry friction.

    On a rotor at rest the air's drag looks like contact friction, which then says nothing of a turning one.

    Args:
        found: what tests show of it.
        whole: all tests together, with the known numbers' uncertainty; None with fewer than two.
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
    """How much χ² more parameters would mend, to first order.

    Attributes:
        gain: drop of χ² in units of what chance explains.
        mended: drop of χ² itself.
        step: their values, shape (k,).
        limit: what chance exceeds once in 1/CHANCE.
    """

    gain: float
    mended: float
    step: np.ndarray
    limit: float

    @property
    def found(self) -> bool:
        """Whether chance does not explain it."""
        return self.gain > self.limit


def evidence(minimum: Minimum, columns: np.ndarray, rounding: np.ndarray | None, sizes: tuple[int, int]) -> Evidence:
    """The score test for parameters that a fit went without.

    Args:
        minimum: of the fit without them.
        columns: derivative of the weighted data residual by them, shape (n, k).
        rounding: errors that the encoders' rounding makes, in standard deviations, shape (draws, n): they follow one
            another near standstill, and chance then mends more than χ² of k says.
        sizes: blocks of each encoder, n in all.
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
