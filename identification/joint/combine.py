"""Joint estimate of several tests that is robust against one bad test.

Steps (docs/theory/joint_estimate.md):

1. An agreement test is made over all tests; the probability of a false alarm is 0.1 %.
2. If one test clearly deviates (odds of 400 to 1 against the next one) and a majority of the tests of the parameter
   remains, the test is left out as a whole. Only parameters that no other test determines are kept of it. Continue
   with step 1.
3. If the bad test cannot be determined (two tests, or two equally suspect ones), the suspects get a common extra error
   per parameter that makes χ² equal to its degrees of freedom (Mandel and Paule). The interval then covers both.
4. A mild disagreement (p < 1 %) of one parameter stretches its interval by sqrt(χ²/dof).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.errors import NotIdentifiable
from identification.estimate import Estimate
from identification.joint.agreement import AgreementVerdict, verdict
from identification.joint.rows import ConsistencyRow, rows_of, spread, values_and_covariance
from identification.joint.weighting import Weighted, parameter_names, weighted
from rig_configs.parameters_file import IdentifiedParameters

_STRETCH_BELOW_P = 1e-2
_MAX_ROUNDS = 60
_MIN_EIGENVALUE = 1e-13  # of a correlation matrix that counts as regular


@dataclass(frozen=True)
class JointEstimate:
    """Joint result of all tests, with its derivation.

    Attributes:
        parameters: values and covariance, in the file's order, with empty provenance.
        rows: comparison per parameter and test, for parameters of at least two tests.
        warnings: tests that disagree, and the consequence.
        estimates: estimates as given.
        weighted: combination. Its pulls belong to the given estimates, with zeros for values that were left out.
        left_out: index of a test that was left out → reason.
        extra_std: name → standard deviation that was added to each suspect test because the bad one is unknown.
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
    """Combine the estimates of all tests, robust against a bad test.

    Args:
        estimates: one per test, in any order.
    Returns:
        Parameters in the file's order; a row per parameter and test for parameters of several tests; warnings.
    Raises:
        NotIdentifiable: no estimate contains a parameter, or a covariance is singular.
    """
    joint = joint_estimate(estimates)
    return joint.parameters, joint.rows, joint.warnings


def joint_estimate(estimates: Sequence[Estimate]) -> JointEstimate:
    """Combine the estimates of all tests and return the derivation: weights, tests left out, widened tests.

    Raises:
        NotIdentifiable: no estimate contains a parameter, or a covariance is not positive definite.
    Source: docs/theory/joint_estimate.md.
    """
    given = list(estimates)
    if not parameter_names(given):
        raise NotIdentifiable("no test gave any parameter")
    for estimate in given:
        _refuse_singular(estimate)
    kept, left_out, extra, warnings = _settled(given)
    together = weighted(kept)
    rows, stretch = list[ConsistencyRow](), np.ones(len(together.names))
    for i, name in enumerate(together.names):
        rows += rows_of(name, given, [j for j in left_out if name not in kept[j].names])
        own = rows_of(name, kept)
        if own and own[0].p < _STRETCH_BELOW_P:
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
    if not finite or np.linalg.eigvalsh(total / np.outer(std, std))[0] < _MIN_EIGENVALUE:
        raise NotIdentifiable(
            f"{estimate.source}: expected finite values with a positive covariance of {', '.join(estimate.names)}, "
            f"got standard deviations {np.array2string(std, precision=3)}, singular. Leave this test out"
        )


def _settled(
    given: list[Estimate],
) -> tuple[list[Estimate], dict[int, str], dict[str, float], list[str]]:
    """Make the tests agree: leave out bad tests, widen suspects if the bad one is unknown.

    Returns:
        The tests; reason by index of a test that was left out; extra standard deviation by parameter; warnings.
    """
    kept, out, names_of = list(given), dict[int, str](), dict[int, set[str]]()
    extra: dict[str, float] = {}
    undecided: dict[tuple[str, ...], str] = {}
    for _ in range(_MAX_ROUNDS):
        found = verdict(kept)
        if not found.alarm:
            break
        bad = found.suspects[0]
        if len(found.suspects) == 1 and _majority_remains(given, kept, found):
            out[bad], names_of[bad] = _why(given[bad], found, kept), set(found.names)
            kept[bad] = _only_seen_here(kept, bad)
            continue
        # the others still disagree without the tests left out for the same parameters: these are taken back
        back = [i for i, names in names_of.items() if names & set(found.names)]
        for i in back:
            kept[i] = given[i]
            del out[i], names_of[i]
        suspects = found.suspects if len(found.suspects) > 1 and not back else tuple(range(len(given)))
        who = _widen(kept, found.names, suspects, extra)
        undecided.setdefault(found.names, _undecided(given, who, found))
    warnings = [_left_out(given[i], kept[i], why) for i, why in out.items()]
    return kept, out, extra, [*warnings, *undecided.values()]


def _majority_remains(given: list[Estimate], kept: list[Estimate], found: AgreementVerdict) -> bool:
    """Whether more than half of the tests remain for the parameter in which the suspect deviates most."""
    name, bad = found.names[0], found.suspects[0]
    having = sum(name in e.names for e in given)
    remaining = sum(name in e.names for i, e in enumerate(kept) if i != bad)
    return 2 * remaining > having


def _only_seen_here(kept: list[Estimate], bad: int) -> Estimate:
    """Reduce a test to the parameters that no other test determines."""
    elsewhere = {n for i, e in enumerate(kept) if i != bad for n in e.names}
    return reduced(kept[bad], [n for n in kept[bad].names if n not in elsewhere])


def reduced(estimate: Estimate, names: Sequence[str]) -> Estimate:
    """Reduce an estimate to some of its parameters."""
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
    """Add an extra error to the suspects in the deviating parameters. Return the indices of the widened tests."""
    who: set[int] = set()
    for name in names:
        having = [i for i, e in enumerate(kept) if name in e.names]
        own = [i for i in having if i in suspects]
        if len(own) < 2:  # a single suspect is as plausible as the others together: all are widened
            own = having
        tau = _extra_std(name, kept, having, own)
        for i in own:
            at = kept[i].names.index(name)
            covariance = kept[i].covariance.copy()
            covariance[at, at] += tau**2
            if tau**2 < 1e-2 * covariance[at, at]:  # they differ only in the correlation of the parameters
                covariance = 4 * covariance
            kept[i] = replace(kept[i], covariance=covariance)
        extra[name] = float(np.hypot(extra.get(name, 0.0), tau))
        who.update(own)
    return tuple(sorted(who))


def _extra_std(name: str, kept: list[Estimate], having: list[int], suspects: list[int]) -> float:
    """Common extra standard deviation of the suspects for which χ² equals its degrees of freedom, by bisection."""
    values, matrix = values_and_covariance(name, [kept[i] for i in having])
    mask = np.array([float(i in suspects) for i in having])
    target = len(having) - 1
    low, high = 0.0, float(np.ptp(values)) * 10 + float(np.sqrt(matrix.max()))
    for _ in range(80):
        tau = 0.5 * (low + high)
        low, high = (tau, high) if spread(values, matrix + np.diag(mask * tau**2)) > target else (low, tau)
    return high


def _pulls_of_given(given: list[Estimate], kept: list[Estimate], together: Weighted) -> list[np.ndarray]:
    """Pulls with columns of zeros for the values that were left out."""
    pulls: list[np.ndarray] = []
    for estimate, used, pull in zip(given, kept, together.pulls, strict=True):
        whole = np.zeros((len(together.names), len(estimate.names)))
        whole[:, [estimate.names.index(n) for n in used.names]] = pull
        pulls.append(whole)
    return pulls


def _why(bad: Estimate, found: AgreementVerdict, kept: list[Estimate]) -> str:
    parts: list[str] = []
    for name, z in zip(found.names, found.z, strict=True):
        own = [r for r in rows_of(name, kept) if (r.test, r.sources) == (bad.test, bad.sources) and r.others]
        off = f" {100 * (own[0].value - own[0].others) / abs(own[0].others):+.3g} %" if own else ""
        parts.append(f"{name}{off} from the others, z = {z:.3g}")
    return f"stands apart ({'; '.join(parts)}; p = {found.p:.1g})"


def _left_out(bad: Estimate, kept: Estimate, why: str) -> str:
    alone = f"; {', '.join(kept.names)} of it is kept, no other test determines it" if kept.names else ""
    return f"tests disagree: {bad.called} {why}. It is left out{alone}. Look at its log, or repeat the test"


def _undecided(given: list[Estimate], suspects: tuple[int, ...], found: AgreementVerdict) -> str:
    who = " or ".join(given[i].called for i in suspects)
    return (
        f"{', '.join(found.names)}: tests disagree (p = {found.p:.1g}) and it cannot be decided whether {who} is bad; "
        "the interval is widened to cover all of them. Repeat one of these tests to decide"
    )
