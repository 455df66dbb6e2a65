"""Search of the smallest adequate model of a passage, with the slow roll and all other rungs in sequence."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from identification.least_squares import Solution
from identification.run_up.choice import ModelSelection
from identification.run_up.design import Design, design_at
from identification.run_up.model import RunUpRecord
from identification.run_up.slow_roll_choice import Doubt, Solve, slow_roll_choice, words


def smallest_adequate(
    record: RunUpRecord,
    solution: Solution,
    design: Design,
    compared: Callable[[Design], ModelSelection],
    solve: Solve,
    slow_roll: bool = True,
) -> tuple[Solution, Design, ModelSelection, Doubt | None]:
    """Find the smallest adequate model.

    The slow roll is tried before the other rungs if it gains more than they do, and again after them: a slow roll that
    stood in for another rung (a lag of the sensors) is not needed next to it.

    Args:
        record: record of the passage.
        solution, design: solution of the fitted model and its linearisation.
        compared: comparison of a model with its neighbours.
        solve: fit of a structure from start values of φ.
        slow_roll: whether a slow roll is permitted.
    Returns:
        Solution, linearisation and comparison of the model, and a model that is not excluded instead, or None.
    """

    def with_rungs() -> tuple[Solution, Design]:
        phi = comparison.structure.project(design.structure.theta(solution.minimum.theta))
        wider = solve(comparison.structure, phi)
        return wider, design_at(record, comparison.structure, wider.minimum.theta)

    comparison = compared(design)
    if not slow_roll:
        if comparison.structure is not design.structure:
            solution, design = with_rungs()
        return solution, design, comparison, None
    found = slow_roll_choice(record, design, solution, solve, comparison.gained)
    if found.structure is not design.structure:
        solution, design = found.solution, design_at(record, found.structure, found.solution.minimum.theta)
        comparison = compared(design)
    if comparison.structure is not design.structure:
        solution, design = with_rungs()
        found = slow_roll_choice(record, design, solution, solve)
        if found.structure is not design.structure:
            solution, design = found.solution, design_at(record, found.structure, found.solution.minimum.theta)
    return (
        solution,
        design,
        replace(
            comparison,
            model=", ".join([comparison.model, *words(design.structure.turning)]),
            table=comparison.table + found.table,
            warnings=comparison.warnings + found.warnings,
        ),
        found.doubt,
    )
