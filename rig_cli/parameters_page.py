"""Identified parameters on the terminal: a file, a comparison, a history."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from identification.compare import Change, ParameterComparison
from identification.history import History
from identification.joint.limits import ParameterLimit
from rig_basics.texts import number_of
from rig_cli.last_sentence import parameters_sentence
from rig_cli.words import local_time, percent, printable, stdout_console
from rig_configs import PARAMETER_UNITS
from rig_configs.physical_numbers import short
from rig_configs.values_in_use import Origin

_ORIGINS: Mapping[Origin, str] = {
    "identified": "identified",
    "design": "rig file: design value, not identified",
    "stated": "rig file",
    "assumed": "rig file; it states no uncertainty, the usual one is assumed",
    "exact": "rig file, stated as exact",
}


def print_parameters(facts: Mapping[str, Any]) -> None:
    """Print one file's page."""
    console = stdout_console()
    console.print(Text(printable(facts["file"]), "bold"), soft_wrap=True)
    about = [str(facts[key]) for key in ("rig", "method", "software") if facts.get(key)]
    if about:
        console.print(Text(printable(" · ".join(about)), "dim"), soft_wrap=True)
    table = _table(("parameter", "value", "± std", "relative", "unit", "limited by", "from"), right=(1, 2, 3))
    for name, row in facts["parameters"].items():
        value, std = rounded(row["value"], row["std"])
        limited = row["limited_by"]
        where = Text("not known", "dim") if limited is None else Text(shares_in_words(limited["shares"]))
        unit = "" if row["unit"] == "1" else row["unit"]
        table.add_row(
            Text(short(name), "bold"), value, std, percent(row["relative_std"]), unit, where, _counted(row["tests"])
        )
    console.print(table)
    for pair in sorted(facts["correlated"], key=lambda p: -abs(p["correlation"])):
        names = " and ".join(short(n) for n in pair["between"])
        console.print(Text.assemble(("correlated   ", "dim"), f"{names} {pair['correlation']:+.2f}"))
    if "in_use" in facts:
        _print_in_use(console, facts["in_use"])
    for test in facts["tests"]:
        if test.get("left_out"):
            console.print(
                Text(f"left out     {test['test']} ({test['log']}) {test['left_out']}", "bold red"), soft_wrap=True
            )
    for name, row in facts["parameters"].items():
        if row["limited_by"] is not None and row["limited_by"]["main"] != "noise":
            console.print(
                Text(f"{short(name):13}{row['limited_by']['main']} limits it: {row['limited_by']['advice']}", "dim"),
                soft_wrap=True,
            )
    if not facts["keeps_its_tests"]:
        console.print(Text("the file has too little of its tests to derive what limits it", "dim"), soft_wrap=True)
    console.print(Text(parameters_sentence(facts)), soft_wrap=True)


def _print_in_use(console: Console, rows: Mapping[str, Mapping[str, Any]]) -> None:
    table = _table(("value in use", "value", "± std", "unit", "origin"), right=(1, 2))
    for name, row in rows.items():
        value, std = rounded(row["value"], row["std"])
        table.add_row(Text(name, "bold"), value, std, row["unit"], _ORIGINS[row["origin"]])
    console.print(table)


def limit_lines(found: list[ParameterLimit]) -> list[str]:
    """Return what limited each result, one line each, for the end of `rig identify`."""
    return [
        f"{limit.name:16} limited by {shares_in_words(limit.shares)}; to do better: {limit.advice}" for limit in found
    ]


def shares_in_words(shares: Mapping[str, float]) -> str:
    """Return for example "noise 80 %, clock 20 %": the shares of at least 5 %, the largest first."""
    main = sorted(((v, k) for k, v in shares.items() if v >= 0.05), reverse=True)
    return ", ".join(f"{k} {100 * v:.0f} %" for v, k in main)


def print_comparison(found: ParameterComparison, words: str, level: float) -> None:
    """Print what changed: as text, then as a table."""
    console = stdout_console()
    changed = bool(found.significant(level)) or found.p < level
    console.print(Text(words, "bold yellow" if changed else "bold green"), soft_wrap=True)
    heads = ("parameter", "unit", "old", "new", "change", "± std", "z", "p", "significant")
    table = _table(heads, right=(2, 3, 4, 5, 6, 7))
    for c in found.changes:
        old, _ = rounded(c.old, c.std)
        new, _ = rounded(c.new, c.std)
        style = "bold yellow" if c.p_holm < level else ""
        table.add_row(
            Text(short(c.name), "bold"),
            PARAMETER_UNITS[c.name],
            old,
            new,
            f"{100 * c.relative:+.4g} %",
            percent(c.relative_std),
            f"{c.z:+.2f}",
            _chance(c.p),
            Text(_significance(c), style),
        )
    console.print(table)
    direction = [f"{short(c.name)} {100 * c.share:.0f} %" for c in _leading(found)]
    console.print(
        Text(
            f"all together: χ² {found.chi2:.4g} for {found.dof}, p {_chance(found.p)}"
            + (f"; of it {', '.join(direction)}" if found.p < level and direction else "")
        ),
        soft_wrap=True,
    )
    console.print(
        Text(
            f"± is one standard deviation; significance counts all "
            f"{number_of(len(found.changes), 'comparison')} (Holm)",
            "dim",
        )
    )
    for names, where in ((found.only_old, "OLD"), (found.only_new, "NEW")):
        if names:
            console.print(Text(f"only in {where}: {', '.join(map(short, names))}", "dim"))
    for note in found.notes:
        console.print(Text(f"note: {note}", "dim"), soft_wrap=True)


def print_history(found: History, overall: str | None, level: float) -> None:
    """Print a row per file with changed values marked, then the changes as text."""
    console = stdout_console()
    names = [n for n in PARAMETER_UNITS if any(n in i.parameters.values for i in found.instants)]
    table = _table(("recorded", "file", *map(short, names)), right=tuple(range(2, 2 + len(names))))
    for instant, step in zip(found.instants, found.steps, strict=True):
        changed = {c.name: c for c in step.significant(level)} if step else {}
        when = local_time(instant.time.isoformat())[:16] + ("" if instant.time_known else "?")
        cells = [_cell(instant.parameters.values, instant.parameters.std, n, changed.get(n)) for n in names]
        table.add_row(when, Text(instant.path.name, "bold"), *cells)
    console.print(table)
    _print_steps(console, found, level)
    if overall is not None:
        console.print(Text.assemble(("first to last: ", "dim"), (overall, "bold")), soft_wrap=True)
    if not all(i.time_known for i in found.instants):
        console.print(Text("? the file has no time of recording of its logs; the file's own time is shown", "dim"))


def _print_steps(console: Console, found: History, level: float) -> None:
    for before, after, step in zip(found.instants, found.instants[1:], found.steps[1:], strict=False):
        if step is None:
            continue
        for c in step.significant(level):
            value = f"{100 * c.relative:+.4g} ± {100 * c.relative_std:.1g} %"
            console.print(
                Text(f"{_name(after.path)}: {short(c.name)} {value} against {_name(before.path)}", "yellow"),
                soft_wrap=True,
            )


def rounded(value: float, std: float) -> tuple[str, str]:
    """Return a value to two digits of its standard deviation, and that; both with the same power of ten."""
    if not (std > 0 and math.isfinite(std)):
        return f"{value:.7g}", "0"
    power = 0
    if value and not 1e-2 <= abs(value) < 1e6:
        power = math.floor(math.log10(abs(value)))
    digits = max(0, 1 - math.floor(math.log10(std)) + power)
    tail = f"e{power:+03d}" if power else ""
    return f"{value / 10**power:.{digits}f}{tail}", f"{std / 10**power:.{digits}f}{tail}"


def _cell(values: Mapping[str, float], std: Mapping[str, float], name: str, change: Change | None) -> Text:
    if name not in values:
        return Text("—", "dim")
    value, spread = rounded(values[name], std[name])
    mark = "" if change is None else (" ▲" if change.change > 0 else " ▼")
    return Text.assemble((value, "bold yellow" if change else ""), (f" ± {spread}", "dim"), (mark, "bold yellow"))


def _table(titles: tuple[str, ...], right: tuple[int, ...]) -> Table:
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    for i, title in enumerate(titles):
        wraps = title in ("from", "limited by")
        table.add_column(title, justify="right" if i in right else "left", no_wrap=not wraps)
    return table


def _counted(tests: list[str]) -> str:
    return ", ".join(f"{n} × {t}" if (n := tests.count(t)) > 1 else t for t in dict.fromkeys(tests))


def _leading(found: ParameterComparison) -> list[Change]:
    return [c for c in sorted(found.changes, key=lambda c: -c.share) if c.share > 0.05]


def _significance(change: Change) -> str:
    return "no" if change.level is None else f"at {100 * change.level:g} %"


def _chance(p: float) -> str:
    return f"{p:.2g}" if p >= 1e-12 else "< 1e-12"


def _name(path: Path) -> str:
    return printable(path.name)
