"""Ports, devices and tables of `rig devices` on the terminal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from rig_basics.texts import number_of
from rig_cli.console import show
from rig_cli.words import printable, stdout_console

_STYLES = {"device": "green", "silent": "dim", "unknown device": "yellow"}


def print_devices(facts: Mapping[str, Any], *, asked: bool, searched: bool) -> None:
    """Print the ports, what is on them, and the tables.

    Args:
        facts: the object that `--json` prints.
        asked: whether requests were sent.
        searched: whether ports were opened.
    """
    console = stdout_console()
    _print_ports(console, facts)
    if searched and facts["ports"]:
        _print_results(console, facts["ports"])
    for each in facts["network"]:
        words = f"on the network: {each['driver']} at {each['port']}, {_words(each['identity'])}"
        console.print(Text(printable(words)))
    for note in facts["ports"]:
        if note["note"]:
            console.print(Text(printable(f"{note['port']}: {note['note']}"), _STYLES.get(note["state"], "bold red")))
    states = {each["state"] for each in facts["ports"]}
    if not asked and states & {"silent", "unknown device"}:
        console.print("Devices that send only on request are found by: rig devices --ask")
    if facts["tables"]:
        console.print("For the rig file:\n")
        for table in facts["tables"]:
            show(table["text"])


def _print_ports(console: Console, facts: Mapping[str, Any]) -> None:
    rows = [(each["port"], each["device"], each["usb"]) for each in facts["serial_ports"]]
    rows += [(port, "", {}) for port in facts["can_channels"]]
    rows += [("", each["kind"], each["usb"]) for each in facts["usb_can_adapters"]]
    if not rows:
        if not facts["ports"]:
            console.print(
                "No serial port and no CAN adapter was found. Is the adapter plugged in, its driver installed?"
            )
        return
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    for heading in ("port", "device", "USB", "maker", "serial number"):
        table.add_column(heading)
    for port, device, usb in rows:
        maker = " ".join(text for key in ("manufacturer", "name") if (text := usb.get(key, "")))
        cells = (port, "" if device == port else device, usb.get("number", ""), maker, usb.get("serial", ""))
        table.add_row(*(Text(printable(cell)) for cell in cells))
    console.print(table)


def _print_results(console: Console, results: list[Mapping[str, Any]]) -> None:
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    for heading in ("port", "found", "identity", "evidence", "time"):
        table.add_column(heading)
    for each in results:
        words = each["driver"] or each["state"]
        table.add_row(
            Text(printable(each["port"])),
            Text(printable(words), _STYLES.get(each["state"], "bold red")),
            Text(printable(_words(each["identity"]))),
            Text(printable(_evidence(each)), "dim"),
            Text(f"{each['seconds']:.1f} s", "dim"),
        )
    console.print(table)


def _evidence(result: Mapping[str, Any]) -> str:
    parts: list[str] = []
    if result["samples"]:
        parts.append(f"{number_of(result['samples'], 'sample')}, {number_of(result['losses'], 'loss', 'losses')}")
    elif result["bytes_in"]:
        parts.append(number_of(result["bytes_in"], "byte"))
    if result["how"] == "answered":
        parts.append("answered a request")
    if result["other_drivers"]:
        parts.append(f"possibly {', '.join(result['other_drivers'])}")
    return ", ".join(parts)


def _words(identity: Mapping[str, Any]) -> str:
    return ", ".join(f"{key} {value}" for key, value in identity.items())
