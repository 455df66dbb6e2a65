"""Comparison of two identifications: size and significance of the change of each parameter and of all together.

Errors that both identifications have in common do not count as change (identification.difference). Masses and lengths
are those of the rig files. Source: docs/theory/joint_estimate.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np
from scipy.special import chdtrc, ndtr

from identification.difference import difference
from identification.errors import NotIdentifiable
from rig_basics.tabular import Column, Tabular
from rig_basics.texts import number_of
from rig_configs.parameters_file import IdentifiedParameters
from rig_configs.physical_numbers import short

LEVELS = (0.001, 0.01, 0.05)
_MIN_DIGITS = 12  # digits of the longest value of a file; a file with fewer has rounded values
_MIN_EIGENVALUE = 1e-11  # of a correlation matrix; smaller ones are rounding of doubles


@dataclass(frozen=True)
class Change:
    """Change of one parameter.

    Attributes:
        name: parameter.
        old, new: values, SI.
        change, std: new − old and its standard deviation, SI.
        z, p: change over std; its two-sided p value for this parameter alone.
        p_holm: p value adjusted for the number of parameters (Holm).
        share: decorrelated share of this parameter in the overall χ². Shares are at least 0 and sum to 1.
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
        """Change over the old value; NaN if the old value is 0."""
        return self.change / abs(self.old) if self.old else float("nan")

    @property
    def relative_std(self) -> float:
        """Standard deviation of the relative change; NaN if the old value is 0."""
        return self.std / abs(self.old) if self.old else float("nan")

    @property
    def level(self) -> float | None:
        """Strictest of the levels 0.1, 1 and 5 % at which p_holm is significant; None if it is not significant."""
        return next((level for level in LEVELS if self.p_holm < level), None)


@dataclass(frozen=True)
class ParameterComparison(Tabular):
    """Comparison of two parameter sets.

    Attributes:
        changes: change of each common parameter, in the file's order.
        covariance: covariance of the changes, shape (n, n), SI; singular for values that depend on the same logs.
        chi2, dof, p: χ² test of all changes together over the dof directions in which a change can be determined.
        only_old, only_new: parameters of one set only.
        notes: errors that were taken as common to both, and unknown facts.
    """

    changes: list[Change]
    covariance: np.ndarray
    chi2: float
    dof: int
    p: float
    only_old: list[str]
    only_new: list[str]
    notes: list[str]

    @property
    def heading(self) -> str:
        """The comparison in one sentence."""
        return self.in_words()

    @property
    def remarks(self) -> list[str]:
        """The notes."""
        return self.notes

    def columns(self) -> Mapping[str, Column]:
        """Return the fields of the changes."""
        return {each.name: [getattr(change, each.name) for change in self.changes] for each in fields(Change)}

    def significant(self, level: float = 0.01) -> list[Change]:
        """Changes whose p_holm is below a level, most significant first."""
        return sorted((c for c in self.changes if c.p_holm < level), key=lambda c: c.p)

    def in_words(self, level: float = 0.01) -> str:
        """Summary of the comparison in one sentence; ± is one standard deviation."""
        found = self.significant(level)
        if found:
            changes = [f"{short(c.name)} {'grew' if c.change > 0 else 'fell'} by {_percent(c)}" for c in found]
            rest = len(self.changes) - len(found)
            return _listed(changes) + ("; nothing else changed significantly" if rest else "")
        if self.p < level:
            leading = [c for c in sorted(self.changes, key=lambda c: -c.share) if c.share > 0.2]
            changes = [f"{short(c.name)} {'up' if c.change > 0 else 'down'} by {_percent(c)}" for c in leading]
            return (
                f"no single parameter changed significantly, but all together they did (p = {self.p:.1g}), "
                f"mostly along {_listed(changes)}"
            )
        return "nothing changed significantly"


def compare_parameters(old: IdentifiedParameters, new: IdentifiedParameters) -> ParameterComparison:
    """Compare two identifications of one rig.

    Raises:
        NotIdentifiable: they have no parameter in common.
        ParametersFileError: the tests in a file are invalid.
    Source: docs/theory/joint_estimate.md.

    Example:
        >>> import numpy as np
        >>> from identification import compare_parameters
        >>> from rig_configs import IdentifiedParameters
        >>> covariance = np.diag([0.5**2, 2e-4**2])
        >>> old = IdentifiedParameters({"k1_N_per_m": 2600.37, "zeta1": 0.02004}, covariance)
        >>> new = IdentifiedParameters({"k1_N_per_m": 2605.12, "zeta1": 0.02013}, covariance)
        >>> [change.name for change in compare_parameters(old, new).significant()]
        ['k1_N_per_m']
    """
    names = [n for n in old.values if n in new.values]
    if not names:
        raise NotIdentifiable(
            f"nothing to compare: OLD has {', '.join(old.values) or 'no parameter'}, "
            f"NEW has {', '.join(new.values) or 'none'}; identify both from tests of the same kind"
        )
    apart = difference(old, new)
    index = [[list(p.values).index(n) for n in names] for p in (old, new)]
    own = old.covariance[np.ix_(index[0], index[0])] + new.covariance[np.ix_(index[1], index[1])]
    before, after = (np.array([p.values[n] for n in names]) for p in (old, new))
    rounding = np.zeros((len(names), len(names)))
    for parameters, without_tests in zip((old, new), apart.without_tests, strict=True):
        if without_tests:
            rounding += np.diag(_rounding(parameters, names) ** 2)
    change, covariance = after - before, apart.covariance_of(names) + rounding
    unit = np.sqrt(np.diag(own + rounding))
    unit[unit == 0] = 1.0  # the significance of a change of an exact value is undefined
    scaled = change / unit
    white, dof = _whitened(
        scaled, covariance / np.outer(unit, unit), (own + rounding) / np.outer(unit, unit), apart.blur**2
    )
    chi2 = float(white @ white)
    shares = white**2 / chi2 if chi2 > 0 else np.zeros(len(names))
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    std[std <= apart.blur * unit] = 0.0  # both values come from the same logs
    z = np.divide(change, std, out=np.zeros(len(names)), where=std > 0)
    p = 2 * ndtr(-np.abs(z))
    changes = [
        Change(name, *map(float, row))
        for name, *row in zip(names, before, after, change, std, z, p, holm(p), shares, strict=True)
    ]
    rigs = [str(parameters.provenance.get("rig", "")) for parameters in (old, new)]
    notes = (
        [f"two rigs, {' and '.join(rigs)}: a change is what sets them apart"] if all(rigs) and len({*rigs}) > 1 else []
    )
    notes += apart.notes
    if dof < len(names):
        notes.append(
            f"{len(names) - dof} of {number_of(len(names), 'direction rests', 'directions rest')} on the "
            f"same logs both times: no change there"
        )
    return ParameterComparison(
        changes,
        covariance,
        chi2,
        dof,
        float(chdtrc(dof, max(chi2, 0.0))) if dof else 1.0,
        [n for n in old.values if n not in new.values],
        [n for n in new.values if n not in old.values],
        notes,
    )


def _whitened(change: np.ndarray, covariance: np.ndarray, own: np.ndarray, blur: float) -> tuple[np.ndarray, int]:
    """Whiten the change symmetrically; return it, shape (n,), and the rank.

    The sum of squares is χ² over the directions in which the variance of the change is known. Each square is the share
    of one parameter (Zuber and Strimmer 2011, CAR scores): these whitened parameters are closest to the parameters.

    Args:
        change, covariance: change and its covariance, shapes (n,), (n, n), in units of `own`'s standard deviations.
        own: covariance of two independent estimates, unit diagonal, shape (n, n).
        blur: variance of a change, over that of `own` in the same direction, below which it is rounding.
    """
    size, vectors = np.linalg.eigh(0.5 * (own + own.T))
    kept = size > _MIN_EIGENVALUE
    white = vectors[:, kept] / np.sqrt(size[kept])  # whiteᵀ own white = 1
    inner = white.T @ covariance @ white
    share, directions = np.linalg.eigh(0.5 * (inner + inner.T))
    known = share > blur
    basis = white @ directions[:, known] / np.sqrt(share[known])  # basis basisᵀ = covariance⁺
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    left, _, right = np.linalg.svd(std[:, None] * basis, full_matrices=False)
    return left @ (right @ (basis.T @ change)), int(np.count_nonzero(known))


def _rounding(parameters: IdentifiedParameters, names: Sequence[str]) -> np.ndarray:
    """Standard deviation of the rounding of a file's values, shape (n,); 0 if the values have all their digits."""
    digits = max(_digits(v) for v in parameters.values.values())
    if digits >= _MIN_DIGITS or len(parameters.values) < 2:  # a single number may be round by chance
        return np.zeros(len(names))
    size = np.array([abs(parameters.values[n]) or 1.0 for n in names])
    return 10.0 ** (np.floor(np.log10(size)) - digits + 1) / np.sqrt(12)


def _digits(value: float) -> int:
    """Number of significant digits of a number in a file, without trailing zeros."""
    return len(repr(abs(value)).partition("e")[0].replace(".", "").strip("0"))


def holm(p: Sequence[float] | np.ndarray) -> np.ndarray:
    """Adjust p values for their number (Holm 1979), shape (n,), in the given order."""
    given = np.asarray(p, float)
    order = np.argsort(given)
    stepped = np.maximum.accumulate(given[order] * np.arange(len(given), 0, -1))
    out = np.empty(len(given))
    out[order] = np.minimum(stepped, 1.0)
    return out


def _percent(change: Change) -> str:
    if not change.old:
        return f"{abs(change.change):.3g} ± {change.std:.1g}"
    std = 100 * change.relative_std
    digits = max(0, 1 - int(np.floor(np.log10(std)))) if std > 0 else 6
    return f"{100 * abs(change.relative):.{digits}f} ± {std:.{digits}f} %"


def _listed(parts: list[str]) -> str:
    return " and ".join(filter(None, (", ".join(parts[:-1]), parts[-1]))) if parts else ""
