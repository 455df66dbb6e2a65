"""Tables of the settings of all drivers, for docs/reference/drivers.md, and of all physical numbers of a rig file."""

from __future__ import annotations

from collections.abc import Iterable

from rig_configs.drivers import installed, settings_of
from rig_configs.physical_numbers import PHYSICAL_NUMBERS, PhysicalNumber
from rig_configs.setting_rows import COMMON, SettingRow, rows_of, tables_inside

# Comment on the page that is replaced by the tables.
MARK = "% The settings of every driver are listed here."
# Comment on the page of rig_configs that is replaced by the table of physical numbers.
NUMBERS_MARK = "% The physical numbers are listed here."
BAR = "\\|"  # in a cell


def _table(rows: Iterable[SettingRow]) -> list[str]:
    cells = [(", ".join(map(_code, row.names)), _code(row.default), row.permitted, row.meaning) for row in rows]
    lines = [f"| {' | '.join(cell.replace('|', BAR) for cell in each)} |" for each in cells]
    return ["", "| setting | default | permitted | meaning |", "|---|---|---|---|", *lines] if lines else []


def _code(text: str) -> str:
    return f"`{text}`" if text else ""


def _range(number: PhysicalNumber) -> str:
    limits = [(">", number.above), ("≥", number.least), ("≤", number.most)]
    return " ".join(f"{sign} {limit:g}" for sign, limit in limits if limit is not None)


def physical_table() -> str:
    """Return the table of physical numbers that a rig file or a parameters file contains."""
    lines = ["| number | symbol | unit | meaning | permitted | usual | not identified |", "|---" * 7 + "|"]
    for key, number in PHYSICAL_NUMBERS.items():
        if number.is_physics or number.parameter:
            usual = "{:g} to {:g}".format(*number.usual) if number.usual else ""
            zero = f", 0: {number.zero}" if number.zero else ""
            prior = f"± {100 * number.design_share:g} %" if number.parameter else ""
            meaning = f"{number.kind} {number.part}".rstrip()
            cells = (_code(key), number.symbol, number.unit, meaning, _range(number), usual + zero, prior)
            lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def all_tables() -> str:
    """Return the common tables, then those of each driver without the common settings."""
    lines: list[str] = []
    common = {name for model in COMMON.values() for name in model.model_fields}
    for title, model in COMMON.items():
        bases = {name for base in model.__mro__[1:] for name in getattr(base, "model_fields", {})}
        lines += ["", f"## {title}", *_table(rows_of(model, bases))]
    for driver in sorted(installed()):
        lines += ["", f"## `{driver}`", *_table(rows_of(settings_of(driver), common))]
        for names, rows in tables_inside(settings_of(driver), common).items():
            lines += ["", f"A table of {names}:", *_table(rows)]
    return "\n".join(lines[1:])
