"""`rig parameters budget`: uncertainty of identified parameters and predicted quantities, and its sources."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from rig_basics.texts import number_of
from rig_cli.console import print_json, wait_for_compilation
from rig_cli.numbers import between
from rig_cli.options import Json, Settings, what_if_words
from rig_cli.parameters_budget_answer import BudgetAnswer, Selection
from rig_cli.share_progress import share_progress
from rig_configs import IdentifiedParameters, Rig, RigFileError, load_rig, overridden

if TYPE_CHECKING:
    from analysis.budget import PredictedBudgets
    from analysis.prediction import Prediction
    from identification.joint.budget import ParameterBudgets
    from uncertainty import Budgets, LinearCheck, MonteCarlo

Level = Annotated[float, Parameter(validator=between(0.5, 0.9999, low_too=True), help="coverage probability")]
Trials = Annotated[
    int | None,
    Parameter(validator=between(100, 2_000_000, low_too=True), help="draws of predictions; parameters get more"),
]
MonteCarloToo = Annotated[
    bool,
    Parameter(name="--monte-carlo", negative="", help="draw every source, compare the linear intervals with it"),
]
_MODEL_TRIALS, _LINEAR_TRIALS = 4_000, 200_000
_KINDS: tuple[Literal["symmetric", "shortest"], ...] = ("symmetric", "shortest")
# Significant digits of the standard uncertainty in the verdict.
_DIGITS = 1


def budget(
    file: Path,
    *names: str,
    rig: Annotated[str | None, Parameter(help="rig file: its known values, and the points")] = None,
    level: Level = 0.95,
    monte_carlo: MonteCarloToo = False,
    trials: Trials = None,
    seed: Annotated[int, Parameter(validator=between(0, 2**31, low_too=True), help="of the draws")] = 1,
    settings: Settings = None,
    json: Json = False,
) -> int:
    """Show the uncertainty of each parameter, with --rig also of each quantity predicted at the points, by source.

    Example: `rig parameters budget parameters.toml`

    Args:
        file: parameters.toml.
        names: parameters (k1), points (D) or their quantities (D.theta3_deg); without one, all.
    """
    from identification.joint.budget import parameter_budgets  # scipy and numba take seconds to import

    if settings and rig is None:
        raise RigFileError("rig parameters budget: --set changes a rig file; give it with --rig")
    identified = IdentifiedParameters.load(file)
    loaded = None if rig is None else load_rig(rig, identified, settings or [])
    selection = _selected(names, identified, loaded)
    of_parameters = parameter_budgets(identified, loaded)
    predicted, skipped = None, dict[str, str]()
    if loaded is not None and selection.points:
        kept = identified.without(overridden(identified, settings or []))
        predicted, skipped = _predicted(loaded, kept, selection, of_parameters)
    exact = {} if loaded is None else _exact(loaded, identified, selection, predicted)
    answer = BudgetAnswer(selection, of_parameters, predicted, exact, skipped)
    if not selection.parameters and not (predicted and any(map(selection.shows, predicted.budgets.names))):
        raise RigFileError(
            f"rig parameters budget: nothing to budget: {'; '.join(f'{n}: {w}' for n, w in skipped.items())}"
        )
    if monte_carlo:
        answer = _drawn(answer, loaded, level, trials, seed)
    if json:
        print_json(_json(file, loaded, answer, level, settings or []))
        return 0
    from rig_cli.parameters_budget_page import print_budget

    print_budget(str(file), loaded, answer, level)
    if settings:
        print(what_if_words(settings))
    return 0


def all_budgets(rig: Rig, identified: IdentifiedParameters) -> Budgets:
    """Return budgets of every parameter, and of every quantity predicted at points where the model has a stable state.

    Args:
        identified: without the values set by hand.
    """
    from identification.joint.budget import parameter_budgets

    selection, of_parameters = (
        Selection(tuple(identified.values), tuple(rig.points)),
        parameter_budgets(identified, rig),
    )
    predicted, skipped = _predicted(rig, identified, selection, of_parameters)
    return BudgetAnswer(selection, of_parameters, predicted, {}, skipped).together


def _selected(names: Sequence[str], identified: IdentifiedParameters, rig: Rig | None) -> Selection:
    """Sort the names into parameters, points and quantities.

    Raises:
        RigFileError: a name is in none of these groups.
    """
    from analysis.budget import quantity_names
    from rig_configs.physical_numbers import short

    points = () if rig is None else tuple(rig.points)
    if not names:
        return Selection(tuple(identified.values), points)
    called = {short(name): name for name in identified.values} | {name: name for name in identified.values}
    parameters, wanted, quantities = dict[str, None](), dict[str, None](), set[str]()
    for name in names:
        point = name.partition(".")[0]
        if name in called:
            parameters[called[name]] = None
        elif point in points and (name == point or name in quantity_names(point)):
            wanted[point] = None
            quantities |= set(quantity_names(point)) if name == point else {name}
        else:
            known = [*map(short, identified.values), *points, *(quantity_names(points[0]) if points else [])]
            hint = "" if rig else "; points of a rig file need --rig"
            raise RigFileError(f"rig parameters budget: no {name!r}; expected any of {', '.join(known)}{hint}")
    return Selection(tuple(parameters), tuple(wanted), frozenset(quantities))


def _predicted(
    rig: Rig, identified: IdentifiedParameters, selection: Selection, of_parameters: ParameterBudgets
) -> tuple[PredictedBudgets | None, dict[str, str]]:
    """Return the budgets of the points, and for points without one the reason."""
    from analysis.budget import predicted_budgets, quantity_names
    from analysis.errors import NoStableState
    from analysis.prediction import known_axis_angle, predict_point

    found: dict[str, Prediction] = {}
    skipped: dict[str, str] = {}
    with wait_for_compilation("dynamics"):
        for point in selection.points:
            speed = rig.physics.speed_rad_s(rig.points[point].speed_ratio)
            try:
                found[point] = predict_point(rig, identified, speed)
            except NoStableState as why:
                skipped[point] = str(why)
    if not found:
        return None, skipped
    angle = known_axis_angle(identified, rig)
    there = identified.axis_angle_deg is not None
    budgets = predicted_budgets(
        found,
        list(identified.values),
        of_parameters.budgets,
        rig,
        angle,
        axis_identified=there,
        slow_roll=identified.slow_roll,
        terms=identified.terms,
    )
    for name in (n for point in found for n in quantity_names(point) if selection.shows(n)):
        if name not in budgets.budgets.names:
            skipped[name] = "it is 0 for all values of the parameters"
    return budgets, skipped


def _exact(
    rig: Rig, identified: IdentifiedParameters, selection: Selection, predicted: PredictedBudgets | None
) -> dict[str, dict[str, float]]:
    """Return number taken as exact → quantity → its change for 0.1 % of the number, in the quantity's unit."""
    from identification.joint.budget import exact_shifts

    order = list(identified.values)
    shifts = {
        number: {name: float(shift[order.index(name)]) for name in selection.parameters}
        for number, shift in exact_shifts(identified, rig.known).items()
    }
    if predicted is not None:
        at = [order.index(name) for name in predicted.parameters]
        by_number = {number: slope[at] for number, slope in identified.by_number.items()}
        for number, shift in predicted.exact_shifts(by_number).items():
            shown = zip(predicted.budgets.names, shift.tolist(), strict=True)
            shifts.setdefault(number, {}).update({name: s for name, s in shown if selection.shows(name)})
    return shifts


def _drawn(answer: BudgetAnswer, rig: Rig | None, level: float, trials: int | None, seed: int) -> BudgetAnswer:
    """Return the answer with a Monte Carlo calculation and its verdicts on the linear intervals."""
    from dataclasses import replace

    from uncertainty import check_linear, monte_carlo

    sampled: list[MonteCarlo] = []
    together = answer.together
    if answer.selection.parameters:
        parameters = answer.of_parameters.budgets
        at = [parameters.names.index(name) for name in answer.selection.parameters]
        values, slopes = parameters.values[at], parameters.sensitivities[at]
        sampled.append(
            monte_carlo(
                lambda errors: values + errors @ slopes.T,
                parameters.sources,
                seed=seed,
                level=level,
                trials=max(trials or 0, _LINEAR_TRIALS),
                names=answer.selection.parameters,
            )
        )
    if answer.predicted is not None and rig is not None:
        from analysis.budget_monte_carlo import NonlinearModel

        count = trials or _MODEL_TRIALS
        found = answer.predicted
        with share_progress(
            f"{number_of(count, 'draw')} of {', '.join(found.predictions)}", count, "draws"
        ) as progress:
            model = NonlinearModel(found, rig.physics, progress, count)
            sampled.append(
                monte_carlo(
                    model, found.budgets.sources, seed=seed, level=level, trials=count, names=found.budgets.names
                )
            )
    checks: dict[str, dict[str, LinearCheck]] = {}
    for result in sampled:
        for quantity in result.quantities:
            if quantity.name in together.names:
                row = together[quantity.name]
                checks[quantity.name] = {k: check_linear(row, result, _DIGITS, interval=k) for k in _KINDS}
    return replace(answer, sampled=tuple(sampled), checks=checks)


def _json(file: Path, rig: Rig | None, answer: BudgetAnswer, level: float, settings: Sequence[str]) -> dict[str, Any]:
    from uncertainty.rows import budget_json

    together = answer.together
    shown = {each.name: budget_json(each, level) for each in together.budgets}
    for name, by_kind in answer.checks.items():
        spread = next(r[name] for r in answer.sampled if name in [q.name for q in r.quantities])
        trials = next(r.trials for r in answer.sampled if name in [q.name for q in r.quantities])
        shown[name]["monte_carlo"] = {
            **spread.to_json(),
            "trials": trials,
            "verdict": by_kind[_KINDS[0]].verdict,
            "checks": {kind: check.to_json() for kind, check in by_kind.items()},
        }
    parameters = set(answer.selection.parameters)
    std = {each.name: each.std for each in together.budgets}
    return {
        "file": str(file),
        "rig": None if rig is None else rig.name,
        "parameters": {name: row for name, row in shown.items() if name in parameters},
        "predicted": {name: row for name, row in shown.items() if name not in parameters},
        "correlation": {"order": list(together.names), "matrix": together.correlation.tolist()},
        "stretch": answer.of_parameters.stretch,
        "taken_as_exact": {
            number: {
                name: {
                    "change": change,
                    "percent": _percent(change, together[name].value),
                    "standard_uncertainties": change / std[name] if std[name] > 0 else None,
                }
                for name, change in changes.items()
            }
            for number, changes in answer.exact.items()
        },
        "without_budget": dict(answer.skipped),
        "notes": list(answer.of_parameters.notes),
        "what_if": list(settings),
    }


def _percent(change: float, value: float) -> float | None:
    return 100 * change / abs(value) if value else None
