"""Sensitivities of a model by central differences, and the second-order terms of its variance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from uncertainty.budgets import Budgets
from uncertainty.errors import BadInput
from uncertainty.group import Input
from uncertainty.model import Model, values_of
from uncertainty.source import ErrorSource


def linear_budgets(
    model: Model, sources: Sequence[Input], names: Sequence[str], units: Sequence[str], *, step: float = 1.0
) -> Budgets:
    """Return budgets of a model's quantities by central differences over ± step standard uncertainties of each source.

    Args:
        model: as for `monte_carlo`; called once, with 2 × columns + 1 rows.
        sources: sources of error, each with a standard uncertainty above 0.
        names: names of the quantities.
        units: units of the quantities.
        step: half-width of the difference in standard uncertainties. With 1 the sensitivities include a mild curvature
            of the model, as in JCGM 100.

    Raises:
        BadInput: a standard uncertainty is 0, the step is not positive, or the names do not match the quantities.
        BadModel: the model's values have another shape or are not finite.
    Source: JCGM 100, 5.1.3, note 2.

    Example:
        >>> import numpy as np
        >>> from uncertainty import ErrorSource, linear_budgets
        >>> mass = ErrorSource("mass", 0.01, "kg", distribution="rectangular")
        >>> sources = [ErrorSource("stiffness", 20.0, "N/m"), mass]
        >>> def speed(errors):
        ...     return np.sqrt((2600.0 + errors[:, :1]) / (7.2 + errors[:, 1:]))
        >>> print(linear_budgets(speed, sources, ["speed"], ["rad/s"])["speed"])
        Budget: speed = 19.0029 ± 0.146 rad/s (95 %, k = 1.96)
        source     type  contribution        share   sensitivity  degrees_of_freedom
        stiffness  B      0.073088709    0.9684293  0.0036544354                 inf
        mass       B      0.013196491  0.031570703    -1.3196491                 inf
    """
    if not step > 0:
        raise BadInput(f"the step is {step}; it must be above 0")
    reach = step * _steps(sources)
    shifts = np.concatenate([np.zeros((1, len(reach))), np.diag(reach), -np.diag(reach)])
    values = values_of(model, shifts)
    up, down = values[1 : len(reach) + 1], values[len(reach) + 1 :]
    table = ((up - down) / (2.0 * reach)[:, None]).T
    return Budgets(tuple(names), values[0], tuple(units), tuple(sources), table)


def second_order_variance(model: Model, sources: Sequence[ErrorSource]) -> NDArray[np.float64]:
    """Return the second-order terms of the variances of a model's quantities, shape (quantities,).

    The terms are Σ_i Σ_j [½ c_ij² + c_i c_ijj] u_i² u_j², with derivatives by differences over one and two standard
    uncertainties. The sum may be negative. The term c_ii is that of a normal distribution. With n sources the model is
    called once with 2 n (n + 1) + 1 rows.

    Args:
        model: as for `monte_carlo`.
        sources: independent sources of error, each with a standard uncertainty above 0.

    Raises:
        BadInput: a standard uncertainty is 0.
        BadModel: the model's values have another shape or are not finite.
    Source: JCGM 100, 5.1.2, note.
    """
    reach = _steps(sources)
    n = len(reach)
    unit = np.diag(reach)
    pairs = [(i, j) for i in range(n) for j in range(i)]
    cross = [s * unit[i] + t * unit[j] for i, j in pairs for s in (1, -1) for t in (1, -1)]
    shifts = np.concatenate([np.zeros((1, n)), unit, -unit, 2 * unit, -2 * unit, np.array(cross).reshape(-1, n)])
    values = values_of(model, shifts)
    centre, (up, down, far_up, far_down) = values[0], np.split(values[1 : 4 * n + 1], 4)
    first = 0.5 * (up - down)
    own = 0.5 * (up - 2.0 * centre + down) ** 2 + first * 0.5 * (far_up - 2.0 * up + 2.0 * down - far_down)
    total = np.sum(own, axis=0)
    for (i, j), (pp, pm, mp, mm) in zip(pairs, values[4 * n + 1 :].reshape(-1, 4, values.shape[1]), strict=True):
        total += (0.25 * (pp - pm - mp + mm)) ** 2  # ½ c_ij² + ½ c_ji²
        total += first[i] * 0.5 * (pp + pm - mp - mm - 2.0 * (up[i] - down[i]))
        total += first[j] * 0.5 * (pp - pm + mp - mm - 2.0 * (up[j] - down[j]))
    return np.asarray(total, dtype=np.float64)


def _steps(sources: Sequence[Input]) -> NDArray[np.float64]:
    """Return the standard uncertainties of all columns, shape (columns,).

    Raises:
        BadInput: there are no sources, or a standard uncertainty is 0.
    """
    for source in sources:
        if bool(np.any(np.asarray(source.std) == 0)):
            raise BadInput(f"source {source.name!r}: std is 0; a difference over it gives no sensitivity")
    if not sources:
        raise BadInput("a model without sources has no sensitivities")
    return np.concatenate([np.atleast_1d(np.asarray(s.std, dtype=np.float64)) for s in sources])
