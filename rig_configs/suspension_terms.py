"""Changes of stiffness and damping of the suspension with the motion, identified by ring-downs.

At the displacement u a spring pulls with k u (1 + H u²). At the speed v a damper pulls with c v (1 + Q |v|). k and c
are the values at zero amplitude. Source: docs/theory/ring_down.md, "Rates that depend on amplitude".
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dynamics.equations.parameters import RotorParameters
from rig_basics.arrays import Array
from rig_configs.error_label import ErrorLabel

TERMS = ("hardening1_per_m2", "hardening2_per_m2", "damping_growth1_s_per_m", "damping_growth2_s_per_m")
"""Names of the terms in the order of their covariance: H1, H2, Q1, Q2."""
UNITS: Mapping[str, str] = dict(zip(TERMS, ("1/m²", "1/m²", "s/m", "s/m"), strict=True))
_GAIN_POWERS = (2, 2, 1, 1)
_ROUNDING = 1e-12  # remainder of a variance that is due to rounding


def term_label(name: str) -> ErrorLabel:
    """Return the label of a term's error that is independent of the terms before it."""
    return ErrorLabel("suspension", name)


@dataclass(frozen=True)
class SuspensionTerms:
    """Terms of both directions.

    Attributes:
        values: H1, H2 (1/m²), Q1, Q2 (s/m), shape (4,); 0 for a direction without the term.
        covariance: covariance of these without the lasers' gains, shape (4, 4); zeros for a term that is excluded.
        found: names of the identified terms. An uncertain term that is not identified is only likely, because the
            other direction has it.
        logs, digests: logs of the tests that identified them.
    Raises:
        ValueError: numbers that are not finite, a covariance of the wrong shape or not positive, or an unknown name.
    """

    values: Array
    covariance: Array
    found: tuple[str, ...]
    logs: tuple[str, ...] = ()
    digests: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.values.shape != (4,) or not np.all(np.isfinite(self.values)):
            raise ValueError(f"expected four finite terms, got {self.values!r}")
        if self.covariance.shape != (4, 4) or not np.all(np.isfinite(self.covariance)):
            raise ValueError(f"covariance must be a finite 4 × 4 matrix, got shape {self.covariance.shape}")
        if np.any(np.diag(self.covariance) < 0) or not np.allclose(self.covariance, self.covariance.T, rtol=1e-9):
            raise ValueError("covariance must be symmetric with no negative variance")
        if unknown := sorted(set(self.found) - set(TERMS)):
            raise ValueError(f"unknown terms {unknown}; known: {list(TERMS)}")

    @property
    def std(self) -> Array:
        """Standard deviations, shape (4,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def shifts(self) -> dict[ErrorLabel, Array]:
        """Independent errors: label → shift of `values` per standard deviation, shape (4,)."""
        left, found = self.covariance.copy(), dict[ErrorLabel, Array]()
        for i, name in enumerate(TERMS):
            if left[i, i] <= _ROUNDING * self.covariance[i, i]:
                continue
            shift = left[i] / math.sqrt(float(left[i, i]))
            found[term_label(name)] = shift
            left = left - np.outer(shift, shift)
        return found

    def errors(self, gain_stds: tuple[float, float]) -> dict[ErrorLabel, Array]:
        """Return all errors shared with other quantities: label → shift of `values` per standard deviation, shape (4,).

        Args:
            gain_stds: relative standard uncertainties of lasers x and y. A laser whose readings are too large makes H
                and Q of its direction too small.
        """
        found = self.shifts
        for k, axis in enumerate("xy"):
            own = np.array([float(i % 2 == k) * power for i, power in enumerate(_GAIN_POWERS)])
            found[ErrorLabel("gain", axis)] = -gain_stds[k] * own * self.values
        return found

    def applied_to(self, physics: RotorParameters) -> RotorParameters:
        """Return the rig with these terms."""
        h1, h2, q1, q2 = self.values.tolist()
        return replace(physics, hardening_per_m2=(h1, h2), damping_growth_s_per_m=(q1, q2))

    @property
    def sentences(self) -> list[str]:
        """Size of each identified term, one line each."""
        rows = zip(TERMS, self.values.tolist(), self.std.tolist(), strict=True)
        return [f"{name:24} {value:14.6g} ± {std:.2g} {UNITS[name]}" for name, value, std in rows if name in self.found]

    def table(self) -> dict[str, Any]:
        """Return the table for parameters.toml."""
        entries: dict[str, Any] = {
            name: {"value": value, "std": std, "unit": UNITS[name], "found": name in self.found}
            for name, value, std in zip(TERMS, self.values.tolist(), self.std.tolist(), strict=True)
        }
        return entries | {
            "covariance": self.covariance.tolist(),
            "logs": list(self.logs),
            "digests": list(self.digests),
        }

    @classmethod
    def of_table(cls, table: Mapping[str, Any]) -> SuspensionTerms:
        """Return the terms of a table of parameters.toml.

        Raises:
            KeyError, TypeError, ValueError: the table is invalid.
        """
        values = np.array([float(table[name]["value"]) for name in TERMS])
        covariance = np.array([[float(cell) for cell in row] for row in table["covariance"]])
        found = tuple(name for name in TERMS if bool(table[name]["found"]))
        logs, digests = (tuple(str(one) for one in table.get(key, ())) for key in ("logs", "digests"))
        return cls(values, covariance, found, logs, digests)


def moved_term(physics: RotorParameters, name: str, step: float) -> RotorParameters:
    """Return a rig with one of TERMS increased by a step."""
    at = TERMS.index(name)
    pairs = [list(physics.hardening_per_m2), list(physics.damping_growth_s_per_m)]
    pairs[at // 2][at % 2] += step
    (h1, h2), (q1, q2) = pairs
    return replace(physics, hardening_per_m2=(h1, h2), damping_growth_s_per_m=(q1, q2))
