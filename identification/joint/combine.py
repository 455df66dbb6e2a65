"""Several tests' answers as one joint estimate that one bad test cannot drag along.

Rule, in this order (docs/theory/joint_estimate.md):

1. An agreement test over all tests at once; chance of a false alarm 0.1 %.
2. Where one test clearly stands apart (400 to 1 against the next) and a majority of the tests of every parameter
   remains, it is left out as a whole; only parameters that no other test shows are kept of it. Back to 1.
3. Where nobody can tell which one is bad (two tests, or two that are as suspect as each other) the suspects get a
   common extra error per parameter that makes χ² equal its degrees of freedom (Mandel and Paule): the interval then
   covers both.
4. A mild disagreement (p < 1 %) of one parameter stretches its interval by sqrt(χ²/dof).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from identification.errors import NotIdentifiable
from identification.estimate import Estimate
from identification.joint.agreement import Verdict, verdict
from identification.joint.rows import ConsistencyRow, rows_of, spread, values_and_covariance
from identification.joint.weighting import Weighted, parameter_names, weighted
from rig_configs.parameters_file import IdentifiedParameters

_STRETCH_BELOW = 1e-2
_MOST_ROUNDS = 60
_SINGULAR = 1e-13  # smallest eigenvalue of a correlation matrix


@dataclass(frozen=True)
class JointEstimate:
    """Everything the tests say together.

    Attributes:
        parameters: values and covariance, in the file's order; provenance empty.
        rows: per parameter and test, where at least two tests have the parameter.
        warnings: which tests disagree, and what was done.
        estimates: as given.
        weighted: the combination; its pulls belong to the estimates as given, with zeros for what was left out.
        left_out: index of a test that was left out → why, in words.
        extra_std: name → standard deviation added to each suspect test because nobody can tell which one is bad.
        stretch: factor on each standard deviation, shape (n,).
    """

    parameters: IdentifiedParameters
    rows: list[ConsistencyRow]
    warnings: list[str]
    estimates: list[Estimate]
    weighted: Weighted
    left_out: dict[int, str]
    extra_std: dict[str, float]
    stretch: np.ndarray


def combine(estimates: Sequence[Estimate]) -> tuple[IdentifiedParameters, list[ConsistencyRow], list[str]]:
    """The joint estimate of everything any test found, robust against a bad test.

    Args:
        estimates: one per test, in any order.
    Returns:
        Parameters in the file's order, a row per parameter and test for parameters found more than once, warnings.
    Raises:
        NotIdentifiable: no estimate at all.
    """
    joint = joint_estimate(estimates)
    return joint.parameters, joint.rows, joint.warnings


def joint_estimate(estimates: Sequence[Estimate]) -> JointEstimate:
    """The same with how it came about: weights, what was left out and widened.

    Raises:
        NotIdentifiable: no estimate at all, or one whose covariance is not positive.
    Source: docs/theory/joint_estimate.md.
    """
    given = list(estimates)
    if not parameter_names(given):
        raise NotIdentifiable("no test gave any parameter")
    for estimate in given:
        _refuse_singular(estimate)
    kept, left_out, extra, warnings = _settled(given)
    together = weighted(kept)
    rows, stretch = [], np.ones(len(together.names))
    for i, name in enumerate(together.names):
        rows += rows_of(name, given, [j for j in left_out if name not in kept[j].names])
        own = rows_of(name, kept)
        if own and own[0].p < _STRETCH_BELOW:
            stretch[i] = np.sqrt(max(1.0, own[0].chi2 / own[0].dof))
    together = replace(together, pulls=_pulls_of_given(given, kept, together))
    table = dict(zip(together.names, together.values.tolist(), strict=True))
    shared = {label: shift * stretch for label, shift in together.shared.items()}
    covariance = together.covariance * np.outer(stretch, stretch)
    parameters = IdentifiedParameters(table, covariance, shared=shared, by_number=together.by_number)
    return JointEstimate(parameters, rows, warnings, given, together, left_out, extra, stretch)


def _refuse_singular(estimate: Estimate) -> None:
    total = estimate.total_covariance
    std = np.sqrt(np.abs(np.diag(total)))
    finite = bool(np.all(np.isfinite(estimate.values)) and np.all(np.isfinite(total)) and np.all(std > 0))
    if not finite or np.linalg.eigvalsh(total / np.outer(std, std))[0] < _SINGULAR:
        raise NotIdentifiable(
            f"{estimate.source}: expected finite values with a positive covariance of {', '.join(estimate.names)}, "
            f"got standard deviations {np.array2string(std, precision=3)}, singular. Leave this test out"
        )


def _settled(
    given: list[Estimate],
) -> tuple[list[Estimate], dict[int, str], dict[str, float], list[str]]:
    """Tests that agree: without the bad ones, widened where nobody can tell; with why, how much, and warnings."""
    kept, out, names_of = list(given), {}, {}
    extra: dict[str, float] = {}
    undecided: list[str] = []
    for _ in range(_MOST_ROUNDS):
        found = verdict(kept)
        if not found.alarm:
            break
        bad = found.suspects[0]
        if len(found.suspects) == 1 and _majority_remains(given, kept, found):
            out[bad], names_of[bad] = _why(given[bad], found, kept), set(found.names)
            kept[bad] = _only_seen_here(kept, bad)
            continue
        # what was left out for the same parameters did not make the others agree: it is no worse than they
        back = [i for i, names in names_of.items() if names & set(found.names)]
        for i in back:
            kept[i] = given[i]
            del out[i], names_of[i]
        suspects = found.suspects if len(found.suspects) > 1 and not back else tuple(range(len(given)))
        who = _widen(kept, found.names, suspects, extra)
        told = _undecided(given, who, found)
        undecided += [told] if not any(w.startswith(told.partition(" (p")[0]) for w in undecided) else []
    warnings = [_left_out(given[i], kept[i], why) for i, why in out.items()]
    return kept, out, extra, warnings + undecided


def _majority_remains(given: list[Estimate], kept: list[Estimate], found: Verdict) -> bool:
    """Whether, of the parameter in which the suspect stands apart most, more than half of the tests remain."""
    name, bad = found.names[0], found.suspects[0]
    having = sum(name in e.names for e in given)
    remaining = sum(name in e.names for i, e in enumerate(kept) if i != bad)
    return 2 * remaining > having


def _only_seen_here(kept: list[Estimate], bad: int) -> Estimate:
    """A test reduced to the parameters that no other test shows."""
    elsewhere = {n for i, e in enumerate(kept) if i != bad for n in e.names}
    return reduced(kept[bad], [n for n in kept[bad].names if n not in elsewhere])


def reduced(estimate: Estimate, names: Sequence[str]) -> Estimate:
    """An estimate of some of its parameters alone."""
    at = [estimate.names.index(n) for n in names]
    shared = {label: v[at] for label, v in estimate.shared.items()}
    return replace(
        estimate,
        names=tuple(names),
        values=estimate.values[at],
        covariance=estimate.covariance[np.ix_(at, at)],
        shared=shared,
        by_number={number: v[at] for number, v in estimate.by_number.items()},
        with_terms={name: v[at] for name, v in estimate.with_terms.items()},
    )


def _widen(
    kept: list[Estimate], names: tuple[str, ...], suspects: tuple[int, ...], extra: dict[str, float]
) -> tuple[int, ...]:
    """Give the suspects an extra error in the parameters that stand apart; returns who got one."""
    who: set[int] = set()
    for name in names:
        having = [i for i, e in enumerate(kept) if name in e.names]
        own = [i for i in having if i in suspects]
        if len(own) < 2:  # the others together look alike to it: none is trusted more
            own = having
        tau = _extra_std(name, kept, having, own)
        for i in own:
            at = kept[i].names.index(name)
            covariance = kept[i].covariance.copy()
            covariance[at, at] += tau**2
            if tau**2 < 1e-2 * covariance[at, at]:  # they differ only in how the parameters go together
                covariance = 4 * covariance
            kept[i] = replace(kept[i], covariance=covariance)
        extra[name] = float(np.hypot(extra.get(name, 0.0), tau))
        who.update(own)
    return tuple(sorted(who))


def _extra_std(name: str, kept: list[Estimate], having: list[int], suspects: list[int]) -> float:
    """The common error of the suspects that brings χ² down to its degrees of freedom, by bisection."""
    values, matrix = values_and_covariance(name, [kept[i] for i in having])
    mask = np.array([float(i in suspects) for i in having])
    target = len(having) - 1
    low, high = 0.0, float(np.ptp(values)) * 10 + float(np.sqrt(matrix.max()))
    for _ in range(80):
        tau = 0.5 * (low + high)
        low, high = (tau, high) if spread(values, matrix + np.diag(mask * tau**2)) > target else (low, tau)
    return high


def _pulls_of_given(given: list[Estimate], kept: list[Estimate], together: Weighted) -> list[np.ndarray]:
    """The pulls with columns of zeros for the values that were left out."""
    pulls = []
    for estimate, used, pull in zip(given, kept, together.pulls, strict=True):
        whole = np.zeros((len(together.names), len(estimate.names)))
        whole[:, [estimate.names.index(n) for n in used.names]] = pull
        pulls.append(whole)
    return pulls


def _called(estimate: Estimate) -> str:
    return f"{estimate.test} ({' + '.join(Path(s).name for s in estimate.source.split(' + '))})"


def _why(bad: Estimate, found: Verdict, kept: list[Estimate]) -> str:
    parts = []
    for name, z in zip(found.names, found.z, strict=True):
        own = [r for r in rows_of(name, kept) if (r.test, r.source) == (bad.test, bad.source) and r.others]
        off = f" {100 * (own[0].value - own[0].others) / abs(own[0].others):+.3g} %" if own else ""
        parts.append(f"{name}{off} from the others, z = {z:.3g}")
    return f"stands apart ({'; '.join(parts)}; p = {found.p:.1g})"


def _left_out(bad: Estimate, kept: Estimate, why: str) -> str:
    alone = f"; {', '.join(kept.names)} of it is kept, no other test shows it" if kept.names else ""
    return f"tests disagree: {_called(bad)} {why}. It is left out{alone}. Look at its log, or repeat the test"


def _undecided(given: list[Estimate], suspects: tuple[int, ...], found: Verdict) -> str:
    who = " or ".join(_called(given[i]) for i in suspects)
    return (
        f"{', '.join(found.names)}: tests disagree (p = {found.p:.1g}) and nobody can tell whether {who} is bad; the "
        "interval is widened to cover all of them. Repeat one of these tests: another answer decides"
    )
