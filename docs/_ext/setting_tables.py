"""Tables of the settings of all drivers, for the page docs/reference/drivers.md."""

from __future__ import annotations

from collections.abc import Iterable

from rig_configs.drivers import installed, settings_of
from rig_configs.setting_rows import COMMON, SettingRow, rows_of, tables_inside

# Comment on the page that is replaced by the tables.
MARK = "% The settings of every driver are listed here."
BAR = "\\|"  # in a cell


def _table(rows: Iterable[SettingRow]) -> list[str]:
    cells = [(", ".join(map(_code, row.names)), _code(row.default), row.permitted, row.meaning) for row in rows]
    lines = [f"| {' | '.join(cell.replace('|', BAR) for cell in each)} |" for each in cells]
    return ["", "| setting | default | permitted | meaning |", "|---|---|---|---|", *lines] if lines else []


def _code(text: str) -> str:
    return f"`{text}`" if text else ""


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
