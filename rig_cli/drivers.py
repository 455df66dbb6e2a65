"""Commands about drivers: list the installed ones, show the settings of one, run the conformance tests on it."""

from __future__ import annotations

import difflib
import os
import re
from dataclasses import asdict
from importlib import import_module
from importlib.metadata import EntryPoint
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import App, Parameter
from pydantic import ValidationError

from rig_cli.console import StepProgress, notify, print_json
from rig_cli.options import Json
from rig_configs.drivers import installed, load_driver
from rig_configs.errors import RigConfigError
from rig_configs.setting_rows import rows_of, tables_inside

if TYPE_CHECKING:
    from daq.drivers.driver import Driver

_THOROUGH_WEIGHT = 300.0  # of the test with 10⁶ inputs in the bar of progress

app: App = App(name="driver")


@app.command(name="list")
def list_(*, json: Json = False) -> int:
    """List the installed drivers: their package and the roles of their devices.

    Example: `rig driver list`
    """
    found = [_facts(name, point) for name, point in installed().items()]
    if json:
        print_json({"drivers": found})
        return 0
    from rig_cli.drivers_page import print_drivers  # rich's tables are slow

    print_drivers(found)
    return 0


@app.command
def show(name: str, *, json: Json = False) -> int:
    """Show the settings of a driver's devices in a rig file, with defaults, permitted values and meaning.

    Example: `rig driver show vesc_can`

    Args:
        name: as in `driver = "…"` of a rig file, or as `rig driver check` takes it.
    """
    chosen = _chosen(name)
    tables = {"": rows_of(chosen.settings), **tables_inside(chosen.settings)}
    if json:
        rows = {title: [asdict(row) for row in table] for title, table in tables.items()}
        print_json({"driver": chosen.name, "settings": rows.pop(""), "tables": rows})
        return 0
    from rig_cli.drivers_page import print_settings

    print_settings(chosen.name, tables)
    return 0


@app.command
def check(
    name: str,
    *,
    thorough: Annotated[
        bool, Parameter(negative="", help="10⁶ damaged inputs in place of 10⁴, on all cores: minutes")
    ] = False,
    json: Json = False,
) -> int:
    """Run the tests that every driver must pass on one driver, with its simulated device; exit 1 when one fails.

    Example: `rig driver check optoncdt`

    Args:
        name: as in `driver = "…"` of a rig file; or PACKAGE:NAME, where PACKAGE is the package it is installed from, or
            a module that contains the unregistered driver as NAME; or PACKAGE alone, if it has only one.
    """
    chosen = _chosen(name)
    from rig_testing import cases  # numba takes a third of a second to import
    from rig_testing.examination import CHECKS
    from rig_testing.report import DriverReport

    weights = dict.fromkeys(CHECKS, 1.0) | ({"mutations": _THOROUGH_WEIGHT} if thorough else {})
    with StepProgress(weights) as progress:

        def show(share: float) -> None:
            progress.update(f"mutations {share:.1%}", share)

        processes = (os.cpu_count() or 1) if thorough else 1
        outcomes: list[Any] = []
        for case in cases(chosen, thorough=thorough, processes=processes, progress=show):
            progress.step(case.name)
            outcomes.append(case.run())
    report = DriverReport(chosen.name, tuple(outcomes))
    if json:
        failed = [{"test": outcome.name, "why": outcome.why} for outcome in report.failed]
        print_json({"driver": report.driver, "passed": report.passed, "failed": failed})
    else:
        from rig_cli.drivers_page import print_report

        print_report(report)
    return 0 if report.passed else 1


def _facts(name: str, point: EntryPoint) -> dict[str, Any]:
    """Return the list entry of a driver. If it cannot be loaded the reason is printed and the entry has no roles."""

    package = point.dist.name if point.dist is not None else point.module.partition(".")[0]
    facts: dict[str, Any] = {"name": name, "package": package, "roles": [], "verified": False}
    try:
        found: Driver = load_driver(name)
        settings = found.example_at("none")
        roles = sorted({role.role for role in settings.roles(name)})
    except (ValueError, AttributeError, ValidationError) as error:
        notify(f"rig: driver {name} of {package}: {error}")
        return facts
    return {**facts, "roles": roles, "verified": found.verified}


def _chosen(name: str) -> Driver:
    """Return the driver of that name.

    Raises:
        RigConfigError: it does not exist.
    """
    package, colon, last = name.rpartition(":")
    if not colon:
        return _loaded(name)
    point = installed().get(last)
    if point is not None and package in _packages(point):
        return _loaded(last)
    try:
        found: Driver = getattr(import_module(package), last)
    except (ImportError, AttributeError, ValueError) as error:
        raise RigConfigError(
            f"no driver {name!r}: expected NAME of an installed driver ({', '.join(installed())}), PACKAGE:NAME, or "
            f"MODULE:OBJECT; {error}"
        ) from error
    if not isinstance(getattr(found, "name", None), str) or not hasattr(found, "pipeline"):
        raise RigConfigError(f"{name} is not a driver: it has no name or no pipeline")
    return found


def _packages(point: EntryPoint) -> set[str]:
    """Return the names of a driver's package: distribution, normalised distribution, top-level module."""
    distribution = point.dist.name if point.dist is not None else ""
    return {distribution, re.sub(r"[-_.]+", "_", distribution).lower(), point.module.partition(".")[0]}


def _loaded(name: str) -> Driver:
    known = installed()
    brought = [each for each, point in known.items() if name in _packages(point)]
    if name not in known and len(brought) > 1:
        raise RigConfigError(
            f"package {name} has several drivers: expected {name}:NAME with one of {', '.join(brought)}"
        )
    if name not in known and brought:
        name = brought[0]
    if name not in known:
        near = difflib.get_close_matches(name, known, 1)
        meant = f" Did you mean {near[0]!r}?" if near else ""
        raise RigConfigError(f"no driver {name!r} is installed, only {', '.join(known)}.{meant}")
    try:
        found: Driver = load_driver(name)
    except ValueError as error:
        raise RigConfigError(str(error)) from error
    return found
