"""Reading of the columns that a recipe names, with plausibility checks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from daq.exchange.columns import Column, ColumnFile, as_column, pick
from daq.exchange.errors import ExchangeError
from daq.exchange.readings import SensorReadings, check_rate, check_size, check_small, read_sensor, times_ns
from daq.exchange.recipe import QUANTITIES, Recipe
from daq.exchange.recordings import open_recording
from daq.exchange.units import ColumnChoice, settle_unit
from daq.log.time_span import LATEST_NS
from rig_basics.texts import number_of
from rig_basics.units import RPM
from rig_configs.schema import Rig

_NANOSECONDS = ColumnChoice("rate", "ns", 1e-9)
_MIN_SPAN_M, _MIN_SPAN_RAD = 1e-6, 1e-4
_MAX_PHASE_RAD = 1e6  # more than a day of operation


def read_sensors(recording: ColumnFile, recipe: Recipe, rig: Rig, warnings: list[str]) -> dict[str, SensorReadings]:
    """Return the readings by "x", "y", "theta3", "theta4", "phase", "speed", and "marks", which consist of times only.

    Args:
        recording: the file.
        recipe: assignment of the columns.
        rig: rig file with the ranges of the sensors.
        warnings: receives warnings about implausible readings.

    Raises:
        ExchangeError: a column is missing, or its values are impossible.
    """
    choices = {name: _settled(recording, name, choice, recipe) for name, choice in recipe.choices.items()}
    marks, time = choices.pop("marks", None), choices.pop("time", None)
    names = {name: pick(recording, choice.name, name) for name, choice in choices.items()}
    timed = {
        name: (choice.time, f"{name} …@TIME") if choice.time else (time, "time") for name, choice in choices.items()
    }
    time_names = {name: pick(recording, own.name, field) for name, (own, field) in timed.items() if own}
    in_file = marks is not None and marks_file(recipe) is None
    mark_name = [pick(recording, marks.name, "marks")] if marks and in_file else []
    columns = recording.read(dict.fromkeys([*names.values(), *time_names.values(), *mark_name]))
    found: dict[str, SensorReadings] = {}
    for name, choice in choices.items():
        column = columns[names[name]]
        own, _ = timed[name]
        times = columns[time_names[name]] if own else _row_times(recipe, column, name)
        readings = read_sensor(column, choice, times, own or _NANOSECONDS, recipe.invalid, name)
        warnings += _check(name, readings, choice, column, own, rig)
        found[name] = readings
    if marks is not None:
        found["marks"] = _marks(recipe, marks, columns[mark_name[0]] if mark_name else None, warnings)
    warnings += recording.remarks
    return found


def _settled(recording: ColumnFile, name: str, choice: ColumnChoice, recipe: Recipe) -> ColumnChoice:
    """Return a choice with its units as given, or as contained in the file above the columns."""
    if name == "marks" and marks_file(recipe) is not None:
        return choice  # its units are in that file
    file_unit = recording.units.get(pick(recording, choice.name, name))
    time = choice.time
    if time is not None:
        place = f"{name} …@TIME"
        time = settle_unit(time, recording.units.get(pick(recording, time.name, place)), "time", place)
    return replace(settle_unit(choice, file_unit, QUANTITIES[name], name), time=time)


def marks_file(recipe: Recipe) -> Path | None:
    """Return the separate file of the marks, or None."""
    marks = recipe.choices.get("marks")
    return Path(marks.name) if marks and Path(marks.name).is_file() else None


def _row_times(recipe: Recipe, column: Column, field: str) -> Column:
    """Return the times of all rows in ns, from the rate alone."""
    if recipe.rate_Hz is None:
        raise ExchangeError(f"{field}: expected a column of times or a rate in addition, got neither")
    if len(column.values) * 1e9 >= recipe.rate_Hz * LATEST_NS:
        raise ExchangeError(
            f"rate {recipe.rate_Hz:g}: expected samples per second; {number_of(len(column.values), 'row')} "
            f"would take more than 146 "
            "years"
        )
    time_ns = np.rint(np.arange(len(column.values)) * (1e9 / recipe.rate_Hz)).astype(np.int64)
    return as_column("rate", time_ns)


def _marks(recipe: Recipe, choice: ColumnChoice, column: Column | None, warnings: list[str]) -> SensorReadings:
    if column is None:
        path = marks_file(recipe)
        assert path is not None
        recording = open_recording(path, recipe.decimal)
        if len(recording.names) != 1:
            raise ExchangeError(
                f"{path}: expected a file of one column of times, got {number_of(len(recording.names), 'column')}"
            )
        choice = settle_unit(choice, recording.units.get(recording.names[0]), "time", "marks")
        column = recording.read([recording.names[0]])[recording.names[0]]
        warnings += recording.remarks
    rows = np.flatnonzero(~column.absent & ~np.isnan(column.values.astype(np.float64)))
    time_ns = times_ns(column.keep(rows), choice, "marks")
    return SensorReadings(time_ns, np.zeros(len(rows)), rows, 0)


def _check(
    name: str, readings: SensorReadings, choice: ColumnChoice, column: Column, time: ColumnChoice | None, rig: Rig
) -> list[str]:
    """Return warnings about one sensor.

    Raises:
        ExchangeError: readings far beyond the possible range.
    """
    quantity = QUANTITIES[name]
    lasers = {sensor.axis: 2 * sensor.reach_m for sensor in rig.roles.displacements}
    unseen = 2 * rig.limits.amplitude_m  # of a displacement whose sensor is not in the rig file
    limits = {"x": unseen, "y": unseen, **lasers, "speed": rig.limits.speed_rpm * RPM}
    check_size(readings, choice, quantity, limits.get(name, _MAX_PHASE_RAD), column, name)
    warnings = [check_rate(readings.time_ns, time, name)]
    if quantity == "length":
        warnings.append(check_small(readings, _MIN_SPAN_M, name, "m"))
    elif name == "phase":
        warnings.append(check_small(readings, _MIN_SPAN_RAD, name, "rad"))
    return [warning for warning in warnings if warning]
