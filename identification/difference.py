"""How two joint estimates differ when they share logs or lasers: the covariance of the difference, log by log.

Both estimates are linear in the tests' values, p = Σ W_i d_i. Their difference is Σ (W'_i − W_i) d_i, so a log that is
in both brings (W'_i − W_i) C_i (W'_i − W_i)ᵀ, one that is in one of them W_i C_i W_iᵀ, and an error that both share
(g' − g)(g' − g)ᵀ. A sum of such terms is never indefinite; C_new + C_old less what is common would be, by rounding,
wherever nearly all is common, and for nested logs it is that near-singular difference which is looked at.
Source: docs/theory/joint_estimate.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from identification.estimate import FOUND_TOGETHER
from identification.joint.combine import JointEstimate
from identification.joint.provenance import KeptTest, rebuilt
from rig_configs.known import LABEL
from rig_configs.parameters_file import IdentifiedParameters

SAME_FIT = 1e-3  # of a standard deviation: two values of one log that are the same fit
_LEAST_BLUR = 10 * SAME_FIT
_BLUR_OF_RESIDUE = 10.0
_ROUNDING = 1e-6  # of a variance

Joint = tuple[JointEstimate, list[KeptTest]]


@dataclass(frozen=True)
class Difference:
    """NEW less OLD.

    Attributes:
        names: all parameters that either has.
        covariance: of the difference, shape (n, n), SI, never indefinite; of a parameter that one of them lacks, the
            other's own.
        blur: standard deviation of a difference, over that of two independent estimates, below which it is rounding:
            of the files' values, and of fits that count as the same.
        notes: what was taken as common to both, and what is not known.
        at_their_word: of OLD and NEW, whether the values are not what the tests kept with them give, so that nothing
            but their digits tells how they were rounded.
    """

    names: tuple[str, ...]
    covariance: np.ndarray
    blur: float
    notes: list[str]
    at_their_word: tuple[bool, bool] = (False, False)

    def covariance_of(self, names: Sequence[str]) -> np.ndarray:
        """The same of some of the parameters, shape (m, m)."""
        at = [self.names.index(n) for n in names]
        return self.covariance[np.ix_(at, at)]


@dataclass(frozen=True)
class _Side:
    """One estimate's own parts, in rows of all parameters: pulls per test, what disagreement adds."""

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

    def felt(self, label: str, only: Sequence[int] | None = None) -> np.ndarray:
        """What one standard deviation of a shared error does, through all of the tests or through some."""
        total = np.zeros(len(self.excess))
        for i, (test, pull) in enumerate(zip(self.tests, self.pulls, strict=True)):
            if label in test.estimate.shared and (only is None or i in only):
                total = total + pull @ test.estimate.shared[label]
        return total

    @property
    def labels(self) -> set[str]:
        return {label for test in self.tests for label in test.estimate.shared}


def difference(old: IdentifiedParameters, new: IdentifiedParameters) -> Difference:
    """The difference of two parameter sets, with what they have in common.

    Raises:
        ParametersFileError: what a file keeps of its tests makes no sense.
    """
    names = tuple(dict.fromkeys([*old.values, *new.values]))
    first, second = rebuilt(old), rebuilt(new)
    if first is None or second is None:
        which = " and ".join(name for name, f in (("OLD", first), ("NEW", second)) if f is None)
        note = f"{which} keeps too little of its tests to know shared errors; all errors count as independent"
        return Difference(
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
    sources = [after.tests[j].estimate.source for j in pairs.values()]
    both = [" + ".join(Path(log).name for log in source.split(" + ")) for source in sources]
    if both:
        is_, its = ("is", "its") if len(both) == 1 else ("are", "their")
        notes.append(f"{', '.join(both)} {is_} in both: {its} own errors cancel")
    residue = max(_residue(first[0], old), _residue(second[0], new))
    blur = max(_LEAST_BLUR, _BLUR_OF_RESIDUE * residue)
    return Difference(names, 0.5 * (covariance + covariance.T), blur if pairs else 0.0, notes)


def _spread(parameters: IdentifiedParameters, names: Sequence[str]) -> np.ndarray:
    at = [names.index(n) for n in parameters.values]
    out = np.zeros((len(names), len(names)))
    out[np.ix_(at, at)] = parameters.covariance
    return out


def _same_fits(before: Sequence[KeptTest], after: Sequence[KeptTest]) -> dict[int, int]:
    """Index in OLD → index in NEW of logs that are in both with the same fit."""
    pairs: dict[int, int] = {}
    for i, old in enumerate(before):
        for j, new in enumerate(after):
            if not old.digest or old.digest != new.digest or old.estimate.names != new.estimate.names:
                continue
            moved = np.abs(old.estimate.values - new.estimate.values) / np.sqrt(np.diag(old.estimate.covariance))
            # fitted another way: how the two fits' errors go together is not known
            if np.all(moved <= SAME_FIT) and j not in pairs.values():
                pairs[i] = j
                break
    return pairs


def _own(before: _Side, after: _Side, pairs: Mapping[int, int]) -> np.ndarray:
    """What the logs' own noise brings."""
    total = np.zeros_like(before.excess)
    for i, (test, pull) in enumerate(zip(before.tests, before.pulls, strict=True)):
        moved = after.pulls[pairs[i]] - pull if i in pairs else pull
        total += moved @ test.estimate.covariance @ moved.T
    for j, (test, pull) in enumerate(zip(after.tests, after.pulls, strict=True)):
        if j not in pairs.values():
            total += pull @ test.estimate.covariance @ pull.T
    return total


def _shared(label: str, before: _Side, after: _Side, pairs: Mapping[int, int]) -> tuple[list[np.ndarray], str | None]:
    """The difference's shifts, independent of one another, for an error that tests share; and what to say of it.

    Through the logs in both it is one error. Besides, it is one where it is the same laser's gain; the line of a
    device's clock is fitted anew in every log.
    """
    old, new = before.felt(label), after.felt(label)
    device, is_clock = label.partition(" ")[2], label.startswith(("clock", FOUND_TOGETHER))
    serials = [set[str]() if is_clock else _serials(side.tests, label, device) for side in (before, after)]
    if serials[0] and serials[0] == serials[1] and len(serials[0]) == 1:
        return [new - old], f"the same {device} (serial {min(serials[0])}) both times: its gain's error cancels"
    in_both = after.felt(label, list(pairs.values())) - before.felt(label, list(pairs))
    old_rest = old - before.felt(label, list(pairs))
    new_rest = new - after.felt(label, list(pairs.values()))
    shifts = [in_both, old_rest, new_rest]
    if label.startswith(f"{LABEL} "):  # a part is weighed and measured once
        return [new - old], None
    if is_clock or not (np.any(old_rest) and np.any(new_rest)):
        return shifts, None
    if serials[0] and serials[1]:
        return shifts, f"another {device}: its gain's error counts twice"
    return shifts, f"which {device} it was is not known: its gain's error counts twice"


def _serials(tests: Sequence[KeptTest], label: str, device: str) -> set[str]:
    """Serial numbers of a device in the tests that feel its error; empty when any of them does not say."""
    feeling = [t for t in tests if label in t.estimate.shared]
    return {t.devices[device] for t in feeling} if all(device in t.devices for t in feeling) else set()


def _residue(joint: JointEstimate, parameters: IdentifiedParameters) -> float:
    """How far a file's values are from what its tests give, in standard deviations: rounding."""
    std = parameters.std
    return max(abs(v - parameters.values[n]) / std[n] for n, v in joint.parameters.values.items())


def _excess(kept: np.ndarray, own: np.ndarray) -> np.ndarray:
    """What disagreement has added to the tests' own covariance, without what rounding leaves."""
    unit = np.sqrt(np.diag(kept))
    unit[unit == 0] = 1.0
    size, vectors = np.linalg.eigh((kept - own) / np.outer(unit, unit))
    size[size < _ROUNDING] = 0.0
    return (vectors * size) @ vectors.T * np.outer(unit, unit)
