"""Drivers on the terminal: the list, the settings of one, and the results of its tests."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from rig_basics.texts import number_of
from rig_cli.words import printable, stdout_console
from rig_configs.setting_rows import SettingRow
from rig_testing.report import DriverReport


def print_drivers(drivers: Sequence[Mapping[str, Any]]) -> None:
    """Print one line a driver."""
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    for heading in ("driver", "package", "roles", "tried on hardware"):
        table.add_column(heading)
    for facts in drivers:
        roles = Text(", ".join(facts["roles"])) if facts["roles"] else Text("cannot be loaded", "bold red")
        verified = Text("yes", "green") if facts["verified"] else Text("no", "dim")
        table.add_row(Text(printable(facts["name"]), "bold"), Text(printable(facts["package"])), roles, verified)
    stdout_console().print(table)


def print_settings(driver: str, tables: Mapping[str, Sequence[SettingRow]]) -> None:
    """Print the settings of a driver, then those of the tables inside.

    Args:
        tables: settings by the name of the table; "" for the device's own.
    """
    console = stdout_console()
    for title, rows in tables.items():
        console.print(Text(f"a table of {title}" if title else f'[devices.NAME]  driver = "{driver}"', "bold"))
        table = Table(box=SIMPLE_HEAD, pad_edge=False)
        for heading in ("setting", "default", "permitted", "meaning"):
            table.add_column(heading)
        for row in rows:
            table.add_row(Text("\n".join(row.names), "bold"), *map(Text, (row.default, row.permitted, row.meaning)))
        console.print(table)


def print_report(report: DriverReport) -> None:
    """Print one line a test, failed ones in red, and the verdict."""
    console = stdout_console()
    table = Table(box=None, pad_edge=False, show_header=False, padding=(0, 2))
    for outcome in report.outcomes:
        mark = (
            Text("–", "dim") if not outcome.tried else Text("✓", "green") if outcome.passed else Text("✗", "bold red")
        )
        style = "dim" if outcome.passed else "bold red"
        seconds = f"{outcome.seconds:.1f} s" if outcome.seconds >= 0.05 else ""
        table.add_row(mark, outcome.name, Text(seconds, "dim"), Text(printable(outcome.why), style))
    console.print(table)
    tried = sum(outcome.tried for outcome in report.outcomes)
    verdict = Text("pass", "bold green") if report.passed else Text(f"{len(report.failed)} FAILED", "bold red")
    console.print(
        Text.assemble(
            (printable(report.driver), "bold"), "  ", verdict, f"  {number_of(tried, 'test')} in {report.seconds:.1f} s"
        )
    )
