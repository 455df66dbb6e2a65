"""Uncertainty budgets of identified parameters: contributions of each test's noise and of each shared error.

The joint values are Σ W_i d_i. Test i contributes W_i C_i W_iᵀ, a group of correlated errors. A share of it stands for
residuals beyond sensor noise. A shared error contributes (W v)(W v)ᵀ, one source for all parameters. The widening of
tests that disagree is a separate group. If a mild disagreement stretches a parameter's interval, its sensitivities to
all sources are stretched by the same factor. Source: docs/theory/joint_estimate.md, docs/theory/uncertainty.md.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from identification.joint.combine import JointEstimate
from identification.joint.provenance import KeptTest, rebuilt
from rig_basics.arrays import Array
from rig_configs.known import KnownNumbers
from rig_configs.parameters_file import PARAMETER_UNITS, IdentifiedParameters
from rig_configs.schema import Rig
from rig_configs.shared_errors import EXACT_STEP, known_source, shared_source
from uncertainty import Budgets, Group
from uncertainty.group import Input

_MIN_SHARE = 1e-9  # of a variance: less is rounding; a covariance may lack its root, 3·10⁻⁵ of a correlation
_MAX_DEVIATION = 0.01  # of a standard uncertainty: a larger deviation from the file's value yields a note


@dataclass(frozen=True)
class ParameterBudgets:
    """Budgets of all parameters of a file.

    Attributes:
        budgets: budgets in the file's order and units.
        stretch: parameter → factor on its interval due to a mild disagreement of its tests; only factors above 1.
        notes: remarks on missing data and on deviations from the file.
    """

    budgets: Budgets
    stretch: dict[str, float]
    notes: tuple[str, ...]


@dataclass
class _Columns:
    """Uncertainty sources and their sensitivities, collected."""

    rows: int
    sources: list[Input] = field(default_factory=list[Input])
    tables: list[Array] = field(default_factory=list[Array])

    def add(self, source: Input, sensitivities: Array) -> None:
        """Add a source with one column of `sensitivities`, shape (rows, columns), per member."""
        if np.any(sensitivities @ source.factor):
            self.sources.append(source)
            self.tables.append(sensitivities)

    def add_shift(self, source: Input, shift: Array) -> None:
        """Add a source by the shift for one standard deviation of it, shape (rows,)."""
        self.add(source, (shift / float(source.factor[0, 0]))[:, None])


def parameter_budgets(parameters: IdentifiedParameters, rig: Rig | None = None) -> ParameterBudgets:
    """Return the budget of every parameter of a file. The variances of a budget sum to the variance in the file.

    With a rig file, the known numbers have the standard uncertainties of the rig file. If the tests were identified
    with other uncertainties of masses, lengths and angles, the sum differs from the file and a note names it.

    Args:
        parameters: parameters as written by `rig identify`.
        rig: standard uncertainties, types, distributions and degrees of freedom of the sources.
    Raises:
        ParametersFileError: a test in the file is invalid.
    """
    n, found = len(parameters.values), rebuilt(parameters)
    columns, notes = _Columns(n), list[str]()
    if found is None:
        scale, shared = np.ones(n), dict(parameters.shared)
        _all_tests_together(parameters, columns)
        notes.append("the file keeps too little of its tests: their own errors are one row")
    else:
        joint, tests = found
        scale = np.sqrt(np.diag(parameters.covariance) / np.diag(joint.parameters.covariance))  # 1 except for rounding
        shared = {label: scale * shift for label, shift in joint.parameters.shared.items()}
        scale = scale * joint.stretch
        _each_test(joint, tests, scale, columns)
    known = KnownNumbers({}) if rig is None else rig.known
    replaced = rig is not None and bool(parameters.by_number)
    for label, shift in shared.items():
        if not (replaced and label.kind == "known"):
            columns.add_shift(shared_source(label, rig), shift)
    if replaced:
        for source in known.sources:
            columns.add_shift(known_source(source), scale * parameters.shift_by(source))
    elif known.sources and rig is not None:
        notes.append(
            "the file has no derivatives by the rig file's numbers: their standard uncertainties do not enter its "
            "parameters; `rig identify` writes the file again"
        )
    units = tuple(PARAMETER_UNITS[name] for name in parameters.values)
    table = np.concatenate([np.zeros((n, 0)), *columns.tables], axis=1)
    budgets = Budgets(
        tuple(parameters.values), np.array(list(parameters.values.values())), units, tuple(columns.sources), table
    )
    notes += _not_as_identified(parameters, budgets)
    stretched = {} if found is None else dict(zip(parameters.values, found[0].stretch.tolist(), strict=True))
    return ParameterBudgets(budgets, {name: s for name, s in stretched.items() if s > 1.0}, tuple(notes))


def exact_shifts(parameters: IdentifiedParameters, known: KnownNumbers) -> dict[str, Array]:
    """Number without a standard uncertainty → shift of the parameters for a relative step EXACT_STEP, shape (n,)."""
    return {
        number: parameters.by_number[number] * EXACT_STEP * known.values[number]
        for number in known.exact
        if number in parameters.by_number
    }


def _all_tests_together(parameters: IdentifiedParameters, columns: _Columns) -> None:
    own = parameters.own_covariance
    names = tuple(parameters.values)
    if np.any(own):
        group = Group("own: all tests together", names, tuple(PARAMETER_UNITS[n] for n in names), own)
        columns.add(group, np.eye(len(names)))


def _each_test(joint: JointEstimate, tests: list[KeptTest], scale: Array, columns: _Columns) -> None:
    """Add the own errors of every test, split into noise and residuals beyond it, and the effect of disagreement."""
    known = np.zeros((len(scale), len(scale)))
    seen: list[str] = []
    for test, pull in zip(tests, joint.weighted.pulls, strict=True):
        estimate = test.estimate
        used = [j for j in range(len(estimate.names)) if np.any(pull[:, j])]
        if not used:
            continue
        weights: Array = pull[:, used]
        covariance: Array = estimate.covariance[np.ix_(used, used)]
        known += weights @ covariance @ weights.T
        members = tuple(estimate.names[j] for j in used)
        units = tuple(PARAMETER_UNITS[name] for name in members)
        called = estimate.called
        seen.append(called)
        if again := seen.count(called) - 1:
            called = f"{called} {again + 1}"
        for begin, share in (("own", 1.0 - test.model_share), ("beyond noise", test.model_share)):
            if share > _MIN_SHARE:
                group = Group(f"{begin}: {called}", members, units, share * covariance)
                columns.add(group, scale[:, None] * weights)
    _disagreement(joint, known, scale, columns)


def _disagreement(joint: JointEstimate, known: Array, scale: Array, columns: _Columns) -> None:
    """Add the widening of tests that disagree: weighed errors minus own errors, without negative rounding errors."""
    own: Array = joint.weighted.own
    added = 0.5 * (own - known + (own - known).T)
    at = [i for i in range(len(own)) if added[i, i] > _MIN_SHARE * own[i, i]]
    if not at:
        return
    names = joint.weighted.names
    std = np.sqrt(np.diag(added)[at])
    sizes, turn = np.linalg.eigh(added[np.ix_(at, at)] / np.outer(std, std))
    sound = (turn * np.maximum(sizes, 0.0)) @ turn.T * np.outer(std, std)
    members = tuple(names[i] for i in at)
    group = Group("disagreement", members, tuple(PARAMETER_UNITS[n] for n in members), 0.5 * (sound + sound.T))
    columns.add(group, scale[:, None] * np.eye(len(names))[:, at])


def _not_as_identified(parameters: IdentifiedParameters, budgets: Budgets) -> list[str]:
    """Return a note if standard uncertainties of parameters differ from the file."""
    found = np.sqrt(np.diag(budgets.covariance))
    other = [
        f"u({name}) is {u:.3g} instead of {parameters.std[name]:.3g}"
        for name, u in zip(parameters.values, found.tolist(), strict=True)
        if abs(u - parameters.std[name]) > _MAX_DEVIATION * parameters.std[name]
    ]
    if not other:
        return []
    return [
        f"the rig file's standard uncertainties are not those the file was identified with: {'; '.join(other)}; "
        "`rig identify` with this rig file weighs the tests by them"
    ]
