"""What changed between two identifications: by how much, how sure, and in which parameters together.

Errors that both have in common do not count as change: the gain of a laser that was the same device both times, and
whole logs that went into both. A device's clock line is fitted anew in every log and is taken as independent.
Masses and lengths are taken as the rig files' both times. Source: docs/theory/joint_estimate.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc, ndtr

from identification.errors import NotIdentifiable
from identification.joint.combine import JointEstimate
from identification.joint.provenance import KeptTest, rebuilt
from rig_configs.parameters_file import IdentifiedParameters

LEVELS = (0.001, 0.01, 0.05)
_FLOOR = 1e-6  # of a value's own variance: what is left where both rest on the same logs
_SAME_FIT = 1e-3  # of a standard deviation: two values of one log that are the same fit


@dataclass(frozen=True)
class Change:
    """One parameter's change.

    Attributes:
        name: the parameter.
        old, new: values, SI.
        change, std: new − old and its standard deviation, SI.
        z, p: change over std; chance of one as large, two-sided, this parameter looked at alone.
        p_holm: the same with all parameters having been looked at (Holm).
        share: part of the overall χ² that this parameter brings; they sum to 1 and may be negative.
    """

    name: str
    old: float
    new: float
    change: float
    std: float
    z: float
    p: float
    p_holm: float
    share: float

    @property
    def relative(self) -> float:
        """Change over the old value; NaN for an old value of 0."""
        return self.change / abs(self.old) if self.old else float("nan")

    @property
    def relative_std(self) -> float:
        """Its standard deviation, relative too."""
        return self.std / abs(self.old) if self.old else float("nan")

    @property
    def level(self) -> float | None:
        """The strictest of 0.1, 1 and 5 % at which the change is significant, all looks counted; None at none."""
        return next((level for level in LEVELS if self.p_holm < level), None)


@dataclass(frozen=True)
class Comparison:
    """Two parameter sets.

    Attributes:
        changes: per parameter that both have, in the file's order.
        covariance: of the changes, shape (n, n), SI.
        chi2, dof, p: all changes together.
        only_old, only_new: parameters of one alone.
        notes: what was taken as common to both, and what is not known.
    """

    changes: list[Change]
    covariance: np.ndarray
    chi2: float
    dof: int
    p: float
    only_old: list[str]
    only_new: list[str]
    notes: list[str]

    def significant(self, level: float = 0.01) -> list[Change]:
        """Changes significant at a level, all looks counted; the most significant first."""
        return sorted((c for c in self.changes if c.p_holm < level), key=lambda c: c.p)


def compare(old: IdentifiedParameters, new: IdentifiedParameters) -> Comparison:
    """Compare two identifications of one rig.

    Raises:
        NotIdentifiable: they have no parameter in common.
        ParametersFileError: what a file keeps of its tests makes no sense.
    Source: docs/theory/joint_estimate.md.
    """
    names = [n for n in old.values if n in new.values]
    if not names:
        raise NotIdentifiable(
            f"nothing to compare: OLD has {', '.join(old.values) or 'no parameter'}, "
            f"NEW has {', '.join(new.values) or 'none'}; identify both from tests of the same kind"
        )
    index = [[list(p.values).index(n) for n in names] for p in (old, new)]
    common, notes = _common_covariance(old, new)
    common = common[np.ix_(index[1], index[0])]
    own = old.covariance[np.ix_(index[0], index[0])] + new.covariance[np.ix_(index[1], index[1])]
    before = np.array([old.values[n] for n in names])
    change = np.array([new.values[n] for n in names]) - before
    unit = np.sqrt(np.diag(own))
    covariance = _positive((own - common - common.T) / np.outer(unit, unit))
    z = change / unit / np.sqrt(np.diag(covariance))
    p = 2 * ndtr(-np.abs(z))
    pull = np.linalg.solve(covariance, change / unit)
    chi2 = float(change / unit @ pull)
    shares = change / unit * pull / chi2 if chi2 > 0 else np.zeros(len(names))
    left = np.diag(covariance)
    std = unit * np.sqrt(np.where(left < 10 * _FLOOR, 0.0, left))  # the floor is no uncertainty
    changes = [
        Change(name, *map(float, row))
        for name, *row in zip(names, before, before + change, change, std, z, p, holm(p), shares, strict=True)
    ]
    return Comparison(
        changes, covariance * np.outer(unit, unit), chi2, len(names), float(chdtrc(len(names), max(chi2, 0.0))),
        [n for n in old.values if n not in new.values], [n for n in new.values if n not in old.values], notes,
    )  # fmt: skip


def holm(p: Sequence[float] | np.ndarray) -> np.ndarray:
    """p values as they are when all of them have been looked at (Holm 1979), shape (n,), in the given order."""
    given = np.asarray(p, float)
    order = np.argsort(given)
    stepped = np.maximum.accumulate(given[order] * np.arange(len(given), 0, -1))
    out = np.empty(len(given))
    out[order] = np.minimum(stepped, 1.0)
    return out


def in_words(comparison: Comparison, level: float = 0.01) -> str:
    """The comparison as an experimenter would say it; ± is one standard deviation."""
    found = comparison.significant(level)
    if found:
        told = [f"{short(c.name)} {'grew' if c.change > 0 else 'fell'} by {_percent(c)}" for c in found]
        rest = len(comparison.changes) - len(found)
        return _listed(told) + ("; nothing else changed significantly" if rest else "")
    if comparison.p < level:
        leading = [c for c in sorted(comparison.changes, key=lambda c: -c.share) if c.share > 0.2]
        told = [f"{short(c.name)} {'up' if c.change > 0 else 'down'} by {_percent(c)}" for c in leading]
        return (
            f"no single parameter changed significantly, but all together they did (p = {comparison.p:.1g}), "
            f"mostly along {_listed(told)}"
        )
    return "nothing changed significantly"


def short(name: str) -> str:
    """k1_N_per_m → k1."""
    return name.partition("_")[0]


def _percent(change: Change) -> str:
    if not change.old:
        return f"{abs(change.change):.3g} ± {change.std:.1g}"
    std = 100 * change.relative_std
    digits = max(0, 1 - int(np.floor(np.log10(std)))) if std > 0 else 6
    return f"{100 * abs(change.relative):.{digits}f} ± {std:.{digits}f} %"


def _listed(parts: list[str]) -> str:
    return " and ".join(filter(None, (", ".join(parts[:-1]), parts[-1]))) if parts else ""


def _positive(matrix: np.ndarray) -> np.ndarray:
    """The matrix with what rounding or a perfect overlap leaves of variance raised to the floor."""
    size, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
    return (vectors * np.maximum(size, _FLOOR)) @ vectors.T


def _common_covariance(old: IdentifiedParameters, new: IdentifiedParameters) -> tuple[np.ndarray, list[str]]:
    """Covariance between NEW's values (rows) and OLD's (columns), and what it rests on."""
    none = np.zeros((len(new.values), len(old.values)))
    first, second = rebuilt(old), rebuilt(new)
    if first is None or second is None:
        which = " and ".join(name for name, f in (("OLD", first), ("NEW", second)) if f is None)
        return none, [f"{which} keeps too little of its tests to know shared errors; all errors count as independent"]
    (before, tests_before), (after, tests_after) = first, second
    total, notes = none, []
    for label in sorted(set(before.weighted.shared) & set(after.weighted.shared)):
        if label.startswith("clock"):
            continue
        device = label.partition(" ")[2]
        serials = [_serials(tests, label, device) for tests in (tests_before, tests_after)]
        if serials[0] and serials[0] == serials[1] and len(serials[0]) == 1:
            total = total + np.outer(after.weighted.shared[label], before.weighted.shared[label])
            notes.append(f"the same {device} (serial {min(serials[0])}) both times: its gain's error cancels")
        elif not (serials[0] and serials[1]):
            notes.append(f"which {device} it was is not known: its gain's error counts twice")
        else:
            notes.append(f"another {device}: its gain's error counts twice")
    shared_logs, logs = _shared_logs((before, tests_before), (after, tests_after))
    total = (total + shared_logs) * np.outer(after.stretch, before.stretch)
    notes += [f"{log} is in both: its own errors cancel" for log in logs]
    return total, notes


def _serials(tests: Sequence[KeptTest], label: str, device: str) -> set[str]:
    """Serial numbers of a device in the tests that feel its error; empty when any of them does not say."""
    feeling = [t for t in tests if label in t.estimate.shared]
    return {t.devices[device] for t in feeling} if all(device in t.devices for t in feeling) else set()


def _shared_logs(
    before: tuple[JointEstimate, list[KeptTest]], after: tuple[JointEstimate, list[KeptTest]]
) -> tuple[np.ndarray, list[str]]:
    """Covariance through logs that are in both with the same fit: their own noise and their clocks' errors."""
    total = np.zeros((len(after[0].weighted.names), len(before[0].weighted.names)))
    logs: list[str] = []
    clocks: dict[
        str, tuple[np.ndarray | float, np.ndarray | float]
    ] = {}  # label → what it did to NEW and OLD through these logs
    for i, old in enumerate(before[1]):
        for j, new in enumerate(after[1]):
            if not old.digest or old.digest != new.digest or old.estimate.names != new.estimate.names:
                continue
            moved = np.abs(old.estimate.values - new.estimate.values) / np.sqrt(np.diag(old.estimate.covariance))
            if np.any(moved > _SAME_FIT):
                continue  # fitted another way: how the two fits' errors go together is not known
            left, right = after[0].weighted.pulls[j], before[0].weighted.pulls[i]
            total += left @ old.estimate.covariance @ right.T
            for label, shift in old.estimate.shared.items():
                if label.startswith("clock") and label in new.estimate.shared:
                    felt = clocks.get(label, (0.0, 0.0))
                    clocks[label] = (felt[0] + left @ new.estimate.shared[label], felt[1] + right @ shift)
            logs.append(new.estimate.source)
    for felt in clocks.values():
        total += np.outer(*felt)  # the joint estimate takes one device's clock for one in all of a file's logs
    return total, logs
