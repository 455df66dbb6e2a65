"""Uncertainty budgets of the predictions at the validation points, by the sources of the parameters' budgets.

A source acts through the parameters. A number of the rig file also acts directly: an error of a mass changes the
identified values and the prediction together. Both effects are added before they are squared, so that each source has
one row. Run-out and bow found by a run-up have rows of their own; a gain or an index angle acts through them too. Dry
friction is independent at each point. The speed is the nominal speed of the point and taken as exact.
Source: docs/theory/uncertainty.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from analysis.dry_friction import LeftOpen
from analysis.prediction import AXIS_ANGLE, QUANTITIES, Prediction
from rig_basics.arrays import Array
from rig_basics.tabular import Column, Tabular
from rig_configs import Rig
from rig_configs.error_label import ErrorLabel
from rig_configs.known import KnownNumbers
from rig_configs.shared_errors import EXACT_STEP, known_source, shared_source
from rig_configs.slow_roll import SlowRoll
from rig_configs.suspension_terms import TERMS, SuspensionTerms
from uncertainty import Budgets, ErrorSource, Group
from uncertainty.group import Input

_AT_REST_M = 1e-12  # amplitude below which a quantity is 0 for all parameters


@dataclass(frozen=True)
class Quantity:
    """One predicted quantity in the unit of the tables.

    Attributes:
        point: name of the point in the rig file.
        index: index in prediction.QUANTITIES.
        name: point and quantity with its unit: "D.theta3_deg", "A.amplitude_mm".
        unit: "deg" or "mm".
        scale: displayed value over SI value.
    """

    point: str
    index: int
    name: str
    unit: str
    scale: float


@dataclass(frozen=True, eq=False)
class PredictedBudgets(Tabular):
    """Budgets of the predicted quantities of some points, with the inputs of a Monte Carlo calculation of them.

    Attributes:
        quantities: m predicted quantities.
        predictions: point → its prediction.
        parameters: names of the identified values behind the predictions, in the order of by_parameter.
        budgets: budgets of the quantities in degrees and millimetres; their sources begin with those of the parameters.
        parameter_sensitivities: derivatives of the parameters by the budgets' columns, shape (n, columns).
        axis_angle_rad: angle from the stiffness x axis to the sensor x axis.
        known: numbers of the rig file that are taken as known.
        slow_roll: run-out and bow behind the predictions.
        slow_roll_sensitivities: derivatives of SlowRoll.values by the budgets' columns, shape (6, columns).
        term_sensitivities: derivatives of the suspension's terms (TERMS) by the budgets' columns, shape (4, columns).
    """

    quantities: tuple[Quantity, ...]
    predictions: Mapping[str, Prediction]
    parameters: tuple[str, ...]
    budgets: Budgets
    parameter_sensitivities: Array
    axis_angle_rad: float
    known: KnownNumbers
    slow_roll: SlowRoll | None
    slow_roll_sensitivities: Array
    term_sensitivities: Array

    def columns(self) -> Mapping[str, Column]:
        """Return the table of the budgets."""
        return self.budgets.columns()

    @cached_property
    def first_columns(self) -> dict[str, int]:
        """First column of each source in the budgets' sensitivities."""
        return columns_of(self.budgets.sources)

    def exact_shifts(self, by_number: Mapping[str, Array]) -> dict[str, Array]:
        """Return the shift of the quantities by EXACT_STEP of each number without a standard uncertainty, shape (m,).

        Args:
            by_number: number → derivatives of the parameters by it, shape (n,). Numbers that are missing here are left
                out.
        """
        found: dict[str, Array] = {}
        for number in self.known.exact:
            if number in by_number:
                step = EXACT_STEP * self.known.values[number]
                found[number] = np.array(
                    [self._by_number(q, number, by_number[number]) * step for q in self.quantities]
                )
        return found

    def _by_number(self, quantity: Quantity, number: str, parameters: Array) -> float:
        predicted, i = self.predictions[quantity.point], quantity.index
        direct = predicted.by_number.get(number, np.zeros(len(QUANTITIES)))[i]
        return quantity.scale * float(predicted.by_parameter[i] @ parameters + direct)


def predicted_budgets(
    predictions: Mapping[str, Prediction],
    names: Sequence[str],
    parameters: Budgets,
    rig: Rig,
    axis_angle_deg: tuple[float, float],
    *,
    axis_identified: bool = True,
    slow_roll: SlowRoll | None = None,
    terms: SuspensionTerms | None = None,
) -> PredictedBudgets:
    """Return the budgets of angles and amplitudes at the points.

    An amplitude that is 0 for all parameters (the balanced state) has no budget and is left out.

    Args:
        predictions: point → prediction for its nominal speed.
        names: names of the parameters, in the order of the predictions' by_parameter.
        parameters: budgets of the parameters; they may contain further parameters.
        rig: rig file with the numbers that are taken as known.
        axis_angle_deg: angle from the stiffness x axis to the sensor x axis and its standard uncertainty.
        axis_identified: whether a test identified the angle.
        slow_roll: run-out and bow behind the predictions.
        terms: terms of the suspension behind the predictions.
    """
    quantities = tuple(q for point, found in predictions.items() for q in _quantities(point, found))
    at = [parameters.names.index(name) for name in names]
    known = rig.known
    rolled = _slow_roll_errors(slow_roll, rig, {source.name for source in parameters.sources})
    changed = {} if terms is None else terms.errors(rig.roles.gain_stds)
    extra = _axis_source(axis_angle_deg[1], axis_identified)
    extra = _with_further_sources(extra, parameters, predictions, rig, rolled, changed)
    frictions = {point: _friction_source(point, found.friction) for point, found in predictions.items()}
    sources: tuple[Input, ...] = (*parameters.sources, *extra, *(f for f in frictions.values() if f is not None))
    columns = columns_of(sources)
    width = sum(source.width for source in sources)
    through, roll, term = np.zeros((len(at), width)), np.zeros((6, width)), np.zeros((len(TERMS), width))
    through[:, : parameters.sensitivities.shape[1]] = parameters.sensitivities[at]
    for source, shift in rolled.values():
        roll[:, columns[source.name]] += shift / float(_unit_of(sources, source.name))
    for label, shift in changed.items():
        if label.text in columns:
            term[:, columns[label.text]] += shift / float(_unit_of(sources, label.text))
    table = np.array([_through(predictions[q.point], q, (through, roll, term)) for q in quantities])
    table = table.reshape(len(quantities), width)
    for row, q in enumerate(quantities):
        own = frictions[q.point]
        if own is not None:
            table[row, columns[own.name] :][: own.width] = q.scale * predictions[q.point].friction.slopes[q.index]
    table += _direct(quantities, predictions, sources, known)
    values = [q.scale * float(predictions[q.point].values[q.index]) for q in quantities]
    budgets = Budgets(
        tuple(q.name for q in quantities), np.array(values), tuple(q.unit for q in quantities), sources, table
    )
    angle = math.radians(axis_angle_deg[0])
    return PredictedBudgets(
        quantities, predictions, tuple(names), budgets, through, angle, known, slow_roll, roll, term
    )


def _axis_source(std_deg: float, identified: bool) -> list[ErrorSource]:
    """Return the source of the axis angle's error; an empty list for an exact angle."""
    kind = "A" if identified else "B"
    return [ErrorSource(AXIS_ANGLE.text, math.radians(std_deg), "rad", kind)] if std_deg > 0 else []


def _with_further_sources(
    axis: list[ErrorSource],
    parameters: Budgets,
    predictions: Mapping[str, Prediction],
    rig: Rig,
    rolled: Mapping[ErrorLabel, tuple[ErrorSource, Array]],
    changed: Mapping[ErrorLabel, Array],
) -> list[ErrorSource]:
    """Return the sources that the parameters' budgets do not contain.

    Args:
        axis: source of the axis angle.
        parameters: budgets of the parameters.
        predictions: point → prediction.
        rig: rig file with the known numbers.
        rolled: label → source and shift of run-out and bow.
        changed: label → shift of the suspension's terms.
    """
    there = {source.name for source in parameters.sources}
    moved = {number for found in predictions.values() for number in found.by_number}
    extra = axis + [
        known_source(source)
        for source in rig.known.sources
        if source.label.text not in there and (moved & set(source.effects) or source.label in rolled)
    ]
    found = [source for label, (source, _) in rolled.items() if label.kind != "known"]
    extra += [source for source in found if source.name not in there]
    there |= {source.name for source in extra}
    return extra + [
        shared_source(label, rig) for label, shift in changed.items() if label.text not in there and np.any(shift)
    ]


def _through(found: Prediction, q: Quantity, sensitivities: tuple[Array, Array, Array]) -> Array:
    """Return a quantity's sensitivities by column, through parameters, run-out and bow, and suspension terms."""
    through, roll, term = sensitivities
    row = q.scale * (found.by_parameter[q.index] @ through + found.by_run_out_and_bow[q.index] @ roll)
    for name, by in found.by_term.items():
        row += q.scale * float(by[q.index]) * term[TERMS.index(name)]
    return row


def friction_label(point: str) -> str:
    """Return the name of the dry-friction source of a point."""
    return f"dry friction at {point}"


def _friction_source(point: str, friction: LeftOpen) -> Input | None:
    """Return the uncertain inputs of dry friction at a point: resting angles of held pendulums, or the shift's size."""
    name = friction_label(point)
    match len(friction.covariance):
        case 0:
            return None
        case 1:
            return ErrorSource(name, math.sqrt(float(friction.covariance[0, 0])), "1")
        case _:
            return Group(name, ("θ3", "θ4"), ("rad", "rad"), friction.covariance)


def _slow_roll_errors(
    slow_roll: SlowRoll | None, rig: Rig, there: set[str]
) -> dict[ErrorLabel, tuple[ErrorSource, Array]]:
    """Return label → source and shift of SlowRoll.values per standard deviation of the source, shape (6,).

    Args:
        there: names of the parameters' sources; an error with such a label is shared with them.
    """
    if slow_roll is None:
        return {}
    found: dict[ErrorLabel, tuple[ErrorSource, Array]] = {}
    for error in slow_roll.own_errors:
        text = error.label.text
        name = text if text in there else f"{text}: {error.words}"
        found[error.label] = ErrorSource(name, error.std_m, "m", "A"), error.std_m * error.direction
    for label, shift in slow_roll.errors(rig.roles.gain_stds, rig.known).items():
        if label not in found and np.any(shift):
            found[label] = (shared_source(label, rig), shift)
    return found


def _unit_of(sources: Sequence[Input], name: str) -> float:
    """Return the standard uncertainty of a source."""
    return next(float(source.factor[0, 0]) for source in sources if source.name == name)


def quantity_names(point: str) -> list[str]:
    """Return the names that the quantities of a point can have, with their units."""
    return [f"{point}.{_shown(name)[0]}" for name in QUANTITIES]


def columns_of(sources: Sequence[Input]) -> dict[str, int]:
    """Return the first column of each source in a table of errors."""
    starts = np.cumsum([0, *(source.width for source in sources)])
    return {source.name: int(start) for source, start in zip(sources, starts, strict=False)}


def _quantities(point: str, found: Prediction) -> list[Quantity]:
    kept: list[Quantity] = []
    for i, name in enumerate(QUANTITIES):
        shown, unit, scale = _shown(name)
        if unit == "deg" or abs(float(found.values[i])) > _AT_REST_M:
            kept.append(Quantity(point, i, f"{point}.{shown}", unit, scale))
    return kept


def _shown(name: str) -> tuple[str, str, float]:
    """Return name with unit, unit, and displayed value over SI value of a quantity."""
    if name.startswith("theta"):
        return f"{name}_deg", "deg", 180 / math.pi
    return f"{name}_mm", "mm", 1e3


def _direct(
    quantities: Sequence[Quantity], predictions: Mapping[str, Prediction], sources: Sequence[Input], known: KnownNumbers
) -> Array:
    """Return the sensitivities at fixed parameters: to the axis angle and to the numbers of the rig file."""
    columns = columns_of(sources)
    units = {source.name: float(source.factor[0, 0]) for source in sources if isinstance(source, ErrorSource)}
    table = np.zeros((len(quantities), sum(source.width for source in sources)))
    for row, q in enumerate(quantities):
        found = predictions[q.point]
        if AXIS_ANGLE.text in columns:
            shift = float(found.shared[AXIS_ANGLE][q.index])
            table[row, columns[AXIS_ANGLE.text]] += q.scale * shift / units[AXIS_ANGLE.text]
        for source in known.sources:
            for number, step in source.effects.items():
                if number in found.by_number and source.label.text in columns:
                    change = q.scale * float(found.by_number[number][q.index]) * step
                    table[row, columns[source.label.text]] += change / units[source.label.text]
    return table
