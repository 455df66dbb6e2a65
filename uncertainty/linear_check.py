"""Validation of a linear budget: comparison of its interval with that of a Monte Carlo calculation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from rig_basics.tabular import Column, Tabular
from uncertainty.budget import Budget, finite
from uncertainty.coverage import Interval, IntervalKind, numerical_tolerance
from uncertainty.errors import BadInput
from uncertainty.spread import MonteCarlo

Verdict = Literal["agree", "differ", "undecided"]


@dataclass(frozen=True)
class LinearCheck(Tabular):
    """Difference between the linear interval and that of the Monte Carlo calculation, in the quantity's unit.

    Attributes:
        low, high: magnitudes of the differences of the lower and of the upper ends, d_low and d_high.
        tolerance: δ, half a unit in the last significant digit of the linear standard uncertainty.
        numerical_error: largest numerical error of the Monte Carlo ends, two standard deviations.
        linear: interval of the budget.
        sampled: interval of the Monte Carlo calculation.
        level: coverage probability of both.
        verdict: "agree" if both differences are within the tolerance, "differ" if one is not. "undecided" if the
            numerical error could change the verdict, so that more trials are needed.
    """

    low: float
    high: float
    tolerance: float
    numerical_error: float
    linear: Interval
    sampled: Interval
    level: float
    verdict: Verdict

    @property
    def heading(self) -> str:
        """Verdict and what it depends on."""
        numbers = f"tolerance {self.tolerance:.3g}, numerical error {self.numerical_error:.3g}"
        return f"LinearCheck: {self.verdict} ({numbers}, {100 * self.level:g} %)"

    def columns(self) -> Mapping[str, Column]:
        """Return a row for each end of the interval."""
        apart = self.low, self.high
        return {"end": ["low", "high"], "linear": self.linear, "sampled": self.sampled, "difference": apart}

    def to_json(self) -> dict[str, object]:
        """Return plain finite values."""
        return {
            "d_low": self.low,
            "d_high": self.high,
            "tolerance": self.tolerance,
            "numerical_error": finite(self.numerical_error),
            "linear": list(self.linear),
            "sampled": list(self.sampled),
            "level": self.level,
            "verdict": self.verdict,
        }


def check_linear(
    budget: Budget,
    result: MonteCarlo,
    digits: int = 2,
    *,
    quantity: str | None = None,
    interval: IntervalKind = "symmetric",
) -> LinearCheck:
    """Compare the linear budget of a quantity with its Monte Carlo distribution.

    JCGM 101, 8.2 requires a Monte Carlo interval that is five times as exact as δ. Here the numerical error of the
    interval is part of the verdict instead.

    Args:
        budget: budget of the quantity, with its value on the scale of the model's values.
        result: Monte Carlo calculation.
        digits: number of relevant significant digits of the standard uncertainty.
        quantity: name of the quantity in the result. None selects the only quantity of the result, or the quantity with
            the budget's name if there are several.
        interval: kind of the Monte Carlo interval.

    Raises:
        BadInput: `digits` is below 1, or the result has no such quantity.
    Source: JCGM 101, 8.1.3 and 8.2.
    """
    names = [q.name for q in result.quantities]
    wanted = quantity if quantity is not None else (names[0] if len(names) == 1 else budget.name)
    if wanted not in names:
        raise BadInput(f"the Monte Carlo result has no quantity {wanted!r}; it has {', '.join(names)}")
    spread = result[wanted]
    linear = budget.interval(result.level)
    sampled = spread.symmetric if interval == "symmetric" else spread.shortest
    low, high = abs(linear[0] - sampled[0]), abs(linear[1] - sampled[1])
    tolerance, doubt = numerical_tolerance(budget.std, digits), max(spread.end_errors)
    verdict: Verdict = "undecided"
    if max(low + spread.end_errors[0], high + spread.end_errors[1]) <= tolerance:
        verdict = "agree"
    elif max(low - spread.end_errors[0], high - spread.end_errors[1]) > tolerance:
        verdict = "differ"
    return LinearCheck(low, high, tolerance, doubt, linear, sampled, result.level, verdict)
