"""Vectors that turn with the shaft at any speed, identified by a run-up: run-out of the surfaces, and a bent shaft."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from rig_basics.arrays import Array
from rig_configs.error_label import ErrorLabel
from rig_configs.known import BOW, INDEX, KnownNumbers, KnownSource

ORDER = ("run_out_x", "run_out_y", "bow")
"""Names of the complex numbers, in the order of the covariance: real and imaginary part of each."""


@dataclass(frozen=True)
class SlowRollError:
    """One independent error of run-out and bow.

    Attributes:
        label: label of the error.
        words: its vector and angle, in words.
        std_m: standard uncertainty, m.
        direction: unit vector in the order of SlowRoll.values, shape (6,).
    """

    label: ErrorLabel
    words: str
    std_m: float
    direction: Array


@dataclass(frozen=True)
class _BowSource(KnownSource):
    @property
    def label(self) -> ErrorLabel:
        """Label of the same error in what points are predicted to show."""
        return ErrorLabel("slow roll", self.name)


_NAMES = ("run-out of x", "run-out of y", "bow")
_MIN_SINGLE, _MIN_PART = 0.99, 0.01  # share of a direction's square: in one vector alone; in a vector that is named


def _words(direction: Array) -> str:
    """Describe the vectors of a direction."""
    pairs = direction.reshape(3, 2)
    shares = np.sum(pairs**2, axis=1)
    if shares.max() > _MIN_SINGLE:
        k = int(shares.argmax())
        return f"{_NAMES[k]} along {math.degrees(math.atan2(pairs[k, 1], pairs[k, 0])) % 180:.0f}°"
    return " with ".join(name for name, share in zip(_NAMES, shares.tolist(), strict=True) if share > _MIN_PART)


@dataclass(frozen=True)
class SlowRoll:
    """Run-out and bow relative to the rotor's phase ψ.

    Attributes:
        run_out_x_m, run_out_y_m: complex; sensor x measures Re(r_x e^{iψ}), sensor y Im(r_y e^{iψ}); 0 without run-out.
        bow_m: complex; rest position of the springs (Re, Im)(b e^{iψ}) in the stiffness axes; 0 without a bow.
        covariance: covariance of their real and imaginary parts without the lasers' gains, shape (6, 6), m².
        bow_shares: shares of lasers x and y in the bow, which contains their gains.
        log, digest: log of the test that identified them.
    Raises:
        ValueError: numbers that are not finite, or a covariance of the wrong shape or with a negative variance.
    """

    run_out_x_m: complex
    run_out_y_m: complex
    bow_m: complex
    covariance: Array
    bow_shares: tuple[float, float] = (0.0, 0.0)
    log: str = ""
    digest: str = ""

    def __post_init__(self) -> None:
        if self.covariance.shape != (6, 6) or not np.all(np.isfinite(self.covariance)):
            raise ValueError(f"covariance must be a finite 6 × 6 matrix, got shape {self.covariance.shape}")
        if np.any(np.diag(self.covariance) < 0) or not np.allclose(self.covariance, self.covariance.T, rtol=1e-9):
            raise ValueError("covariance must be symmetric with no negative variance")
        if not all(map(math.isfinite, self.values.tolist())):
            raise ValueError("expected finite numbers")

    @property
    def values(self) -> Array:
        """Real and imaginary parts in the order of the covariance, shape (6,), m."""
        parts = (self.run_out_x_m, self.run_out_y_m, self.bow_m)
        return np.array([value for one in parts for value in (one.real, one.imag)])

    @property
    def own_errors(self) -> tuple[SlowRollError, ...]:
        """Independent errors, along the principal axes of the covariance."""
        sizes, turn = np.linalg.eigh(0.5 * (self.covariance + self.covariance.T))
        kept = [j for j, size in enumerate(sizes.tolist()) if size > 1e-12 * max(float(sizes[-1]), 1e-300)]
        return tuple(
            SlowRollError(ErrorLabel("slow roll", f"{k}"), _words(turn[:, j]), math.sqrt(float(sizes[j])), turn[:, j])
            for k, j in enumerate(kept, start=1)
        )

    @property
    def bow_sources(self) -> tuple[KnownSource, ...]:
        """Independent errors as sources for tests whose motion contains the bow; empty without a bow."""
        if not self.bow_m:
            return ()
        moved = {error.label.of: (error.std_m * error.direction[4:]).tolist() for error in self.own_errors}
        return tuple(_BowSource(name, 1.0, "1", dict(zip(BOW, parts, strict=True))) for name, parts in moved.items())

    @property
    def shifts(self) -> dict[ErrorLabel, Array]:
        """Independent errors: label → shift of `values` per standard deviation, shape (6,)."""
        return {error.label: error.std_m * error.direction for error in self.own_errors}

    def errors(self, gain_stds: tuple[float, float], known: KnownNumbers) -> dict[ErrorLabel, Array]:
        """Return all errors shared with other quantities: label → shift of `values` per standard deviation, shape (6,).

        Args:
            gain_stds: relative standard uncertainties of lasers x and y, whose gains scale run-out and bow.
            known: for the index angle; a larger index angle yields the same vector at a smaller angle.
        """
        found, values = self.shifts, self.values
        for k, axis in enumerate("xy"):
            share = np.zeros(6)
            share[2 * k : 2 * k + 2], share[4:] = 1.0, self.bow_shares[k]
            found[ErrorLabel("gain", axis)] = gain_stds[k] * share * values
        turned = np.array([part for z in values.reshape(3, 2) for part in (z[1], -z[0])])
        for source in known.sources:
            if INDEX in source.effects:
                found[source.label] = turned * source.effects[INDEX]
        return found

    @property
    def sentences(self) -> list[str]:
        """Size and angle of each vector that is not 0, one line each."""
        lines: list[str] = []
        for k, (name, (real, imaginary)) in enumerate(zip(ORDER, self.values.reshape(3, 2).tolist(), strict=True)):
            size = math.hypot(real, imaginary)
            if size > 0:
                unit = np.array([real, imaginary]) / size
                std = math.sqrt(float(unit @ self.covariance[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] @ unit))
                angle = math.degrees(math.atan2(imaginary, real))
                lines.append(
                    f"{name:16} {1e6 * size:14.4g} ± {1e6 * std:.2g} µm at {angle:.1f}°, turning with the shaft"
                )
        return lines

    def table(self) -> dict[str, Any]:
        """Return the table for parameters.toml."""
        values = self.values.reshape(3, 2)
        std = np.sqrt(np.diag(self.covariance)).reshape(3, 2)
        entries: dict[str, Any] = {
            name: {
                "real_m": float(v[0]),
                "imaginary_m": float(v[1]),
                "real_std_m": float(s[0]),
                "imaginary_std_m": float(s[1]),
            }
            for name, v, s in zip(ORDER, values, std, strict=True)
        }
        return entries | {
            "covariance": self.covariance.tolist(),
            "bow_shares": list(self.bow_shares),
            "log": self.log,
            "digest": self.digest,
        }

    @classmethod
    def of_table(cls, table: Mapping[str, Any]) -> SlowRoll:
        """Return run-out and bow of a table of parameters.toml.

        Raises:
            KeyError, TypeError, ValueError: the table is invalid.
        """
        x, y, bow = (complex(float(table[n]["real_m"]), float(table[n]["imaginary_m"])) for n in ORDER)
        first, second = (float(share) for share in table["bow_shares"])
        covariance = np.array([[float(cell) for cell in row] for row in table["covariance"]])
        return cls(x, y, bow, covariance, (first, second), str(table.get("log", "")), str(table.get("digest", "")))
