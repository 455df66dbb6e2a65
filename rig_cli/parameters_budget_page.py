"""Uncertainty budgets on the terminal: a summary, a table per quantity, numbers taken as exact, Monte Carlo."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from rig_basics.texts import number_of
from rig_cli.parameters_page import rounded
from rig_cli.words import printable, stdout_console
from rig_configs import Rig
from rig_configs.shared_errors import EXACT_STEP
from uncertainty import Budget, Budgets
from uncertainty.rows import BudgetRow, budget_rows

if TYPE_CHECKING:
    from rig_cli.parameters_budget_answer import BudgetAnswer

_LEAST_SHARE = 1e-3  # share of a variance below which a source has no row of its own
_LEAST_SIGMAS = 0.1  # standard uncertainties below which a change is not shown among the numbers taken as exact
_CORRELATED = 0.5
_MATRIX = 9  # number of quantities up to which the correlation matrix fits a page


def print_budget(file: str, rig: Rig | None, answer: BudgetAnswer, level: float) -> None:
    """Print the page of `rig parameters budget`."""
    console, together = stdout_console(), answer.together
    console.print(Text(printable(file if rig is None else f"{file} · {rig.name}"), "bold"), soft_wrap=True)
    console.print(_summary(together, level))
    for each in together.budgets:
        _print_one(console, each, level)
    _print_correlation(console, together)
    _print_exact(console, rig, answer, together)
    _print_monte_carlo(console, answer)
    for name, factor in answer.of_parameters.stretch.items():
        text = f"{name}: its tests mildly disagree; every contribution is stretched by {factor:.3g}"
        console.print(Text(text, "yellow"), soft_wrap=True)
    for why in dict.fromkeys(answer.skipped.values()):
        names = ", ".join(name for name, text in answer.skipped.items() if text == why)
        console.print(Text(f"no budget of {names}: {printable(why)}", "yellow"), soft_wrap=True)
    for note in answer.of_parameters.notes:
        console.print(Text(f"note: {printable(note)}", "dim"), soft_wrap=True)


def _summary(together: Budgets, level: float) -> Table:
    share = f"{100 * level:g} %"
    table = _table(
        ("quantity", "value", "± u", "unit", "ν_eff", "k", f"U ({share})", f"interval ({share})", "mainly"),
        right=(1, 2, 4, 5, 6),
    )
    for each in together.budgets:
        low, high = each.interval(level)
        value, u = rounded(each.value, each.std)
        main = [f"{row.source} {_share(row.share)}" for row in budget_rows(each)[:1]]
        table.add_row(
            Text(each.name, "bold"),
            value,
            u,
            _unit(each.unit),
            _degrees(each.degrees_of_freedom),
            f"{each.coverage_factor(level):.3f}",
            rounded(each.expanded(level), each.std)[0],
            f"{rounded(low, each.std)[0]} … {rounded(high, each.std)[0]}",
            Text(printable(", ".join(main))),
        )
    return table


def _print_one(console: Console, budget: Budget, level: float) -> None:
    value, u = rounded(budget.value, budget.std)
    k = budget.coverage_factor(level)
    console.print(
        Text.assemble(
            (f"{budget.name} = {value} {_unit(budget.unit)}", "bold"),
            f"   u {u}, ν_eff {_degrees(budget.degrees_of_freedom)}, k {k:.3f}",
        )
    )
    rows = budget_rows(budget)
    shown = [row for row in rows if row.share >= _LEAST_SHARE]
    table = _table(
        ("source", "type", "distribution", "ν", "u", "unit", "sensitivity", "contribution", "share"),
        right=(3, 4, 6, 7, 8),
    )
    for row in shown:
        table.add_row(*_cells(row))
    if len(rows) > len(shown):
        others = rows[len(shown) :]
        sum_of = math.hypot(*(row.contribution for row in others))
        table.add_row(
            Text(f"{len(others)} more", "dim"),
            "",
            "",
            "",
            "",
            "",
            "",
            f"{sum_of:.3g}",
            _share(sum(row.share for row in others)),
        )
    console.print(table)


def _cells(row: BudgetRow) -> list[str | Text]:
    return [
        Text(printable(row.source)),
        row.kind,
        row.distribution,
        _degrees(row.degrees_of_freedom),
        f"{row.u:.4g}",
        _unit(row.unit),
        f"{row.sensitivity:.5g}",
        f"{row.contribution:+.4g}",
        _share(row.share),
    ]


def _print_correlation(console: Console, together: Budgets) -> None:
    """Print the matrix if it fits, else its largest entries; the JSON contains all of them."""
    matrix, names = together.correlation, together.names
    if 1 < len(names) <= _MATRIX:
        table = _table(("correlation", *names), right=tuple(range(1, len(names) + 1)))
        for name, row in zip(names, matrix, strict=True):
            table.add_row(Text(name, "bold"), *(f"{r:+.2f}" for r in row.tolist()))
        console.print(table)
        return
    pairs = [(float(matrix[i, j]), names[i], names[j]) for i in range(len(names)) for j in range(i)]
    for r, one, other in sorted((p for p in pairs if abs(p[0]) > _CORRELATED), key=lambda p: -abs(p[0])):
        console.print(Text.assemble(("correlated   ", "dim"), f"{one} and {other} {r:+.2f}"))


def _print_exact(console: Console, rig: Rig | None, answer: BudgetAnswer, together: Budgets) -> None:
    if rig is None or not rig.known.exact:
        return
    console.print(Text(f"taken as exact: effect of {100 * EXACT_STEP:g} % of each number", "bold"))
    if not answer.exact:
        missing = f"{', '.join(rig.known.exact)}: the file has no derivatives by these numbers; identify again"
        console.print(Text(missing, "dim"), soft_wrap=True)
        return
    table = _table(("number", "value", "quantity", "change", "in standard uncertainties"), right=(1, 3, 4))
    hidden = 0
    for number, changes in answer.exact.items():
        head = (number, f"{rig.known.values[number]:g}")
        for name, change in changes.items():
            one = together[name]
            sigmas = change / one.std if one.std > 0 else math.inf
            if change and abs(sigmas) >= _LEAST_SIGMAS:
                relative = f"{100 * change / abs(one.value):+.3g} %" if one.value else "—"
                table.add_row(*head, name, relative, f"{sigmas:+.2f}" if math.isfinite(sigmas) else "—")
                head = ("", "")
            hidden += 0 < abs(sigmas) < _LEAST_SIGMAS
    console.print(table)
    if hidden:
        console.print(
            Text(f"{number_of(hidden, 'change')} below {_LEAST_SIGMAS:g} standard uncertainties are in --json", "dim")
        )


def _print_monte_carlo(console: Console, answer: BudgetAnswer) -> None:
    if not answer.checks:
        return
    trials = " and ".join(str(result.trials) for result in answer.sampled)
    kind = "symmetric"
    console.print(Text(f"Monte Carlo, {number_of(trials, 'draw')}, {kind} interval against the linear one", "bold"))
    heads = ("quantity", "mean", "std", "interval", "d_low", "d_high", "δ", "± numerical", "verdict")
    table = _table(heads, right=(1, 2, 4, 5, 6, 7))
    spreads = {spread.name: spread for result in answer.sampled for spread in result.quantities}
    for name, by_kind in answer.checks.items():
        check, spread = by_kind[kind], spreads[name]
        style = {"agree": "green", "differ": "bold yellow", "undecided": "dim"}[check.verdict]
        low, high = check.sampled
        table.add_row(
            Text(name, "bold"),
            rounded(spread.mean, spread.std)[0],
            rounded(spread.mean, spread.std)[1],
            f"{rounded(low, spread.std)[0]} … {rounded(high, spread.std)[0]}",
            f"{check.low:.2g}",
            f"{check.high:.2g}",
            f"{check.tolerance:.2g}",
            f"{check.numerical_error:.1g}",
            Text(check.verdict, style),
        )
    console.print(table)
    if any(by_kind[kind].verdict == "undecided" for by_kind in answer.checks.values()):
        console.print(Text("undecided: the draws are too few to resolve δ; give more --trials", "dim"))


def _table(titles: tuple[str, ...], right: tuple[int, ...]) -> Table:
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    for i, title in enumerate(titles):
        table.add_column(title, justify="right" if i in right else "left", no_wrap=title not in ("source", "mainly"))
    return table


def _unit(unit: str) -> str:
    return "" if unit == "1" else unit


def _share(share: float) -> str:
    return f"{100 * share:.1f} %" if share >= _LEAST_SHARE else f"{100 * share:.1g} %"


def _degrees(degrees: float) -> str:
    return f"{degrees:.0f}" if math.isfinite(degrees) else "∞"
