"""Table of the checks of `rig check`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.table import Table
from rich.text import Text

from daq.acquisition.device_check import passed
from daq.drivers.checks import Checks, Verdict
from rig_cli.words import printable, stdout_console

_MARKS: Mapping[Verdict, Text] = {
    "pass": Text("✓", "green"),
    "fail": Text("✗", "bold red"),
    "not resolved": Text("–", "yellow"),
}


def print_checks(devices: Mapping[str, Checks], identities: Mapping[str, Mapping[str, Any]], seconds: float) -> None:
    """Print the table on standard output, with the reason next to a failed check."""
    console = stdout_console()
    for name, checks in devices.items():
        verdict = Text("pass", "bold green") if passed(checks) else Text("FAIL", "bold red")
        known = ", ".join(f"{key} {value}" for key, value in identities.get(name, {}).items())
        console.print(Text.assemble((name, "bold"), "  ", verdict, "  ", (printable(known), "dim")), soft_wrap=True)
        table = Table(box=None, pad_edge=False, show_header=False, padding=(0, 2))
        for check, found in checks.items():
            style = "bold red" if found.failed else ""
            mark = _MARKS[found.verdict]
            value = "—" if found.value is None else printable(found.value)
            expected = "" if found.expected is None else f"expected {printable(found.expected)}"
            table.add_row(mark, check, Text(value, style), Text(expected, "dim"), Text(printable(found.note), style))
        console.print(table)
    console.print(Text(f"looked for {seconds:.1f} s", "dim"))
