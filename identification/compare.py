"""What changed between two identifications: by how much, how sure, and in which parameters together.

Errors that both have in common do not count as change (identification.difference). Masses and lengths are taken as the
rig files' both times. Source: docs/theory/joint_estimate.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc, ndtr

from identification.difference import difference
from identification.errors import NotIdentifiable
from rig_configs.parameters_file import IdentifiedParameters

LEVELS = (0.001, 0.01, 0.05)
_FEWEST_DIGITS = 12  # of the longest value of a file; below, its values have been rounded
_OWN_RANK = 1e-11  # eigenvalue of a correlation matrix below which a direction is rounding of doubles


@dataclass(frozen=True)
class Change:
    """One parameter's change.

    Attributes:
        name: the parameter.
        old, new: values, SI.
        change, std: new − old and its standard deviation, SI.
        z, p: change over std; chance of one as large, two-sided, this parameter looked at alone.
        p_holm: the same with all parameters having been looked at (Holm).
        share: part of the overall χ² that this parameter brings, correlations taken out; at least 0, they sum to 1.
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
        covariance: of the changes, shape (n, n), SI; singular where both rest on the same logs.
        chi2, dof, p: all changes together, over the dof directions in which there can be a change that is known.
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

    def in_words(self, level: float = 0.01) -> str:
        """The comparison as an experimenter would say it; ± is one standard deviation."""
        found = self.significant(level)
        if found:
            told = [f"{short(c.name)} {'grew' if c.change > 0 else 'fell'} by {_percent(c)}" for c in found]
            rest = len(self.changes) - len(found)
            return _listed(told) + ("; nothing else changed significantly" if rest else "")
        if self.p < level:
            leading = [c for c in sorted(self.changes, key=lambda c: -c.share) if c.share > 0.2]
            told = [f"{short(c.name)} {'up' if c.change > 0 else 'down'} by {_percent(c)}" for c in leading]
            return (
                f"no single parameter changed significantly, but all together they did (p = {self.p:.1g}), "
                f"mostly along {_listed(told)}"
            )
        return "nothing changed significantly"


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
    apart = difference(old, new)
    index = [[list(p.values).index(n) for n in names] for p in (old, new)]
    own = old.covariance[np.ix_(index[0], index[0])] + new.covariance[np.ix_(index[1], index[1])]
    before, after = (np.array([p.values[n] for n in names]) for p in (old, new))
    rounding = np.zeros((len(names), len(names)))
    for parameters, at_its_word in zip((old, new), apart.at_their_word, strict=True):
        if at_its_word:
            rounding += np.diag(_rounding(parameters, names) ** 2)
    change, covariance = after - before, apart.covariance_of(names) + rounding
    unit = np.sqrt(np.diag(own + rounding))
    unit[unit == 0] = 1.0  # a value that is called exact: any change of it is beyond judgement
    scaled = change / unit
    white, dof = _whitened(
        scaled, covariance / np.outer(unit, unit), (own + rounding) / np.outer(unit, unit), apart.blur**2
    )
    chi2 = float(white @ white)
    shares = white**2 / chi2 if chi2 > 0 else np.zeros(len(names))
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    std[std <= apart.blur * unit] = 0.0  # both rest on the same logs
    z = np.divide(change, std, out=np.zeros(len(names)), where=std > 0)
    p = 2 * ndtr(-np.abs(z))
    changes = [
        Change(name, *map(float, row))
        for name, *row in zip(names, before, after, change, std, z, p, holm(p), shares, strict=True)
    ]
    notes = [*apart.notes]
    if dof < len(names):
        notes.append(f"{len(names) - dof} of {len(names)} directions rest on the same logs both times: no change there")
    return Comparison(
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
    """The change with its correlations taken out symmetrically, shape (n,), and the rank.

    Its square is χ² over the directions in which the change's variance is known, and each square the parameter's part
    of it (Zuber and Strimmer 2011, CAR scores): the whitened parameters that are nearest to the parameters themselves.

    Args:
        change, covariance: of the change, shapes (n,), (n, n), in units of `own`'s standard deviations.
        own: covariance if nothing were common to both, unit diagonal, shape (n, n).
        blur: variance of a change, over that of `own` in the same direction, below which it is rounding.
    """
    size, vectors = np.linalg.eigh(0.5 * (own + own.T))
    kept = size > max(_OWN_RANK, 1e-15 * float(size[-1]))
    white = vectors[:, kept] / np.sqrt(size[kept])  # whiteᵀ own white = 1
    inner = white.T @ covariance @ white
    share, directions = np.linalg.eigh(0.5 * (inner + inner.T))
    known = share > blur
    basis = white @ directions[:, known] / np.sqrt(share[known])  # basis basisᵀ = covariance⁺
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    left, _, right = np.linalg.svd(std[:, None] * basis, full_matrices=False)
    return left @ (right @ (basis.T @ change)), int(np.count_nonzero(known))


def _rounding(parameters: IdentifiedParameters, names: Sequence[str]) -> np.ndarray:
    """Standard deviations that a file's own rounding brings, shape (n,); 0 where its values have all their digits."""
    digits = max((_digits(v) for v in parameters.values.values()), default=17)
    if digits >= _FEWEST_DIGITS or len(parameters.values) < 2:  # one number may be round by chance
        return np.zeros(len(names))
    size = np.array([abs(parameters.values[n]) or 1.0 for n in names])
    return 10.0 ** (np.floor(np.log10(size)) - digits + 1) / np.sqrt(12)


def _digits(value: float) -> int:
    """Significant digits of a number as it stands in a file, without zeros at its end."""
    return len(repr(abs(value)).partition("e")[0].replace(".", "").strip("0"))


def holm(p: Sequence[float] | np.ndarray) -> np.ndarray:
    """p values as they are when all of them have been looked at (Holm 1979), shape (n,), in the given order."""
    given = np.asarray(p, float)
    order = np.argsort(given)
    stepped = np.maximum.accumulate(given[order] * np.arange(len(given), 0, -1))
    out = np.empty(len(given))
    out[order] = np.minimum(stepped, 1.0)
    return out


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
