"""Covariance of the difference of two joint estimates that share logs or lasers, summed log by log.

Both estimates are linear in the tests' values, p = Σ W_i d_i. Their difference is Σ (W'_i − W_i) d_i. A log that is in
both adds (W'_i − W_i) C_i (W'_i − W_i)ᵀ, a log in one of them W_i C_i W_iᵀ, and a shared error (g' − g)(g' − g)ᵀ.
A sum of such terms is never indefinite. C_new + C_old minus the common part is indefinite by rounding if nearly all is
common; for nested logs this near-singular difference is the quantity of interest.
Source: docs/theory/joint_estimate.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from identification.joint.combine import JointEstimate
from identification.joint.provenance import KeptTest, rebuilt
from identification.sources import log_names
from rig_configs.error_label import ErrorLabel
from rig_configs.parameters_file import IdentifiedParameters

SAME_FIT = 1e-3  # of a standard deviation: largest difference of two values of one log that count as the same fit
_MIN_BLUR = 10 * SAME_FIT  # of a standard deviation
_BLUR_PER_RESIDUE = 10.0
_ROUNDING = 1e-6  # of a variance

Joint = tuple[JointEstimate, list[KeptTest]]


@dataclass(frozen=True)
class ParameterDifference:
    """Difference NEW − OLD.

    Attributes:
        names: parameters of either estimate.
        covariance: covariance of the difference, shape (n, n), SI, never indefinite. A parameter that one estimate
            lacks has the variance of the other.
        blur: limit of the standard deviation of a difference over that of two independent estimates. Below it, the
            difference is rounding of the files' values or of fits that count as the same.
        notes: errors that were taken as common to both, and unknown facts.
        without_tests: for OLD and NEW, whether the values cannot be recomputed from tests in the file. Their rounding
            is then estimated from their digits.
    """

    names: tuple[str, ...]
    covariance: np.ndarray
    blur: float
    notes: list[str]
    without_tests: tuple[bool, bool] = (False, False)

    def covariance_of(self, names: Sequence[str]) -> np.ndarray:
        """Covariance of the difference of some parameters, shape (m, m)."""
        at = [self.names.index(n) for n in names]
        return self.covariance[np.ix_(at, at)]


@dataclass(frozen=True)
class _Side:
    """Parts of one estimate in rows of all parameters: pulls per test and covariance added by disagreement."""

    tests: list[KeptTest]
    pulls: list[np.ndarray]
    excess: np.ndarray

    @classmethod
    def of(cls, joint: Joint, names: Sequence[str]) -> _Side:
        estimate, tests = joint
        rows = np.zeros((len(names), len(estimate.weighted.names)))
        rows[[names.index(n) for n in estimate.weighted.names], range(rows.shape[1])] = 1.0
        stretched = rows * estimate.stretch
        pulls = [stretched @ pull for pull in estimate.weighted.pulls]
        own = np.zeros((len(names), len(names)))
        for test, pull in zip(tests, pulls, strict=True):
            own += pull @ test.estimate.covariance @ pull.T
        kept = stretched @ estimate.weighted.own @ stretched.T
        return cls(tests, pulls, _excess(kept, own))

    def shift_by(self, label: ErrorLabel, only: Sequence[int] | None = None) -> np.ndarray:
        """Shift of the parameters for one standard deviation of a shared error, through all tests or some of them."""
        total = np.zeros(len(self.excess))
        for i, (test, pull) in enumerate(zip(self.tests, self.pulls, strict=True)):
            if label in test.estimate.shared and (only is None or i in only):
                total = total + pull @ test.estimate.shared[label]
        return total

    @property
    def labels(self) -> set[ErrorLabel]:
        return {label for test in self.tests for label in test.estimate.shared}


def difference(old: IdentifiedParameters, new: IdentifiedParameters) -> ParameterDifference:
    """Return the covariance of the difference of two parameter sets, with their common errors.

    Raises:
        ParametersFileError: the tests in a file are invalid.
    """
    names = tuple(dict.fromkeys([*old.values, *new.values]))
    first, second = rebuilt(old), rebuilt(new)
    if first is None or second is None:
        which = " and ".join(name for name, f in (("OLD", first), ("NEW", second)) if f is None)
        note = f"{which} keeps too little of its tests to identify shared errors; all errors count as independent"
        return ParameterDifference(
            names, _spread(old, names) + _spread(new, names), 0.0, [note], (first is None, second is None)
        )
    before, after = _Side.of(first, names), _Side.of(second, names)
    pairs = _same_fits(before.tests, after.tests)
    covariance = _own(before, after, pairs) + before.excess + after.excess
    notes: list[str] = []
    for label in sorted(before.labels | after.labels):
        shifts, note = _shared(label, before, after, pairs)
        covariance = covariance + sum((np.outer(v, v) for v in shifts), 0.0)
        notes += [note] if note else []
    both = [log_names(after.tests[j].estimate.sources) for j in pairs.values()]
    if both:
        is_, its = ("is", "its") if len(both) == 1 else ("are", "their")
        notes.append(f"{', '.join(both)} {is_} in both: {its} own errors cancel")
    residue = max(_residue(first[0], old), _residue(second[0], new))
    blur = max(_MIN_BLUR, _BLUR_PER_RESIDUE * residue)
    return ParameterDifference(names, 0.5 * (covariance + covariance.T), blur if pairs else 0.0, notes)


def _spread(parameters: IdentifiedParameters, names: Sequence[str]) -> np.ndarray:
    at = [names.index(n) for n in parameters.values]
    out = np.zeros((len(names), len(names)))
    out[np.ix_(at, at)] = parameters.covariance
    return out


def _same_fits(before: Sequence[KeptTest], after: Sequence[KeptTest]) -> dict[int, int]:
    """Index in OLD → index in NEW of the logs that are in both with the same fit."""
    pairs: dict[int, int] = {}
    for i, old in enumerate(before):
        for j, new in enumerate(after):
            if not old.digest or old.digest != new.digest or old.estimate.names != new.estimate.names:
                continue
            moved = np.abs(old.estimate.values - new.estimate.values) / np.sqrt(np.diag(old.estimate.covariance))
            # the correlation of the errors of two different fits is not known
            if np.all(moved <= SAME_FIT) and j not in pairs.values():
                pairs[i] = j
                break
    return pairs


def _own(before: _Side, after: _Side, pairs: Mapping[int, int]) -> np.ndarray:
    """Contribution of the logs' own noise."""
    total = np.zeros_like(before.excess)
    for i, (test, pull) in enumerate(zip(before.tests, before.pulls, strict=True)):
        moved = after.pulls[pairs[i]] - pull if i in pairs else pull
        total += moved @ test.estimate.covariance @ moved.T
    for j, (test, pull) in enumerate(zip(after.tests, after.pulls, strict=True)):
        if j not in pairs.values():
            total += pull @ test.estimate.covariance @ pull.T
    return total


def _shared(
    label: ErrorLabel, before: _Side, after: _Side, pairs: Mapping[int, int]
) -> tuple[list[np.ndarray], str | None]:
    """Independent shifts of the difference for an error that tests share, and a note about it.

    The error is the same through the logs that are in both estimates. For other logs it is the same only if it is the
    gain of the same laser; the line of a device's clock is fitted in every log.
    """
    old, new = before.shift_by(label), after.shift_by(label)
    is_gain, laser = label.kind == "gain", f"laser along {label.of}"
    serials = [_serials(side.tests, label) if is_gain else set[str]() for side in (before, after)]
    if serials[0] and serials[0] == serials[1] and len(serials[0]) == 1:
        return [new - old], f"the same {laser} (serial {min(serials[0])}) both times: its gain's error cancels"
    in_both = after.shift_by(label, list(pairs.values())) - before.shift_by(label, list(pairs))
    old_rest = old - before.shift_by(label, list(pairs))
    new_rest = new - after.shift_by(label, list(pairs.values()))
    shifts = [in_both, old_rest, new_rest]
    if label.kind == "known":  # a part is weighed and measured only once
        return [new - old], None
    if not is_gain or not (np.any(old_rest) and np.any(new_rest)):
        return shifts, None
    if serials[0] and serials[1]:
        return shifts, f"another {laser}: its gain's error counts twice"
    return shifts, f"the serial number of the {laser} is not known: its gain's error counts twice"


def _serials(tests: Sequence[KeptTest], label: ErrorLabel) -> set[str]:
    """Serial numbers of the laser in the tests with its gain's error; empty if one of these tests has none."""
    affected = [t for t in tests if label in t.estimate.shared]
    return {t.lasers[label.of] for t in affected} if all(label.of in t.lasers for t in affected) else set()


def _residue(joint: JointEstimate, parameters: IdentifiedParameters) -> float:
    """Largest deviation of a file's values from the values of its tests, in standard deviations (rounding)."""
    std = parameters.std
    return max(abs(v - parameters.values[n]) / std[n] for n, v in joint.parameters.values.items())


def _excess(kept: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Covariance that disagreement has added to the tests' own covariance, without rounding errors."""
    unit = np.sqrt(np.diag(kept))
    unit[unit == 0] = 1.0
    size, vectors = np.linalg.eigh((kept - own) / np.outer(unit, unit))
    size[size < _ROUNDING] = 0.0
    return (vectors * size) @ vectors.T * np.outer(unit, unit)
