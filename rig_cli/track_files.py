"""A tracked run as a table of its steps and as a figure."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.figures.style import save
from analysis.figures.tracked import TrackedDamping, TrackedPicture, TrackedState, draw_tracked
from daq.exchange import ExchangeError
from daq.exchange.arrow_files import ArrowFiles
from daq.exchange.provenance import source_facts
from daq.exchange.staging import Staging
from daq.exchange.tables import Layout
from identification.tracking.replay import SmoothedRun, TrackedRun
from identification.tracking.tracker import STATE_NAMES
from rig_basics.arrays import Array
from rig_cli.console import plain
from rig_cli.track_page import Tracking, tracking_json

TABLES, FIGURES = (".parquet", ".csv", ".npz"), (".svg", ".png", ".pdf")
_DAMPINGS = ("c3_Nms_per_rad", "c4_Nms_per_rad")


@dataclass(frozen=True)
class TrackFiles:
    """Files of one log's results; None: not requested."""

    table: Path | None = None
    figure: Path | None = None


def places(output: Path | None, log: Path, alone: bool) -> TrackFiles:
    """Return the files that `-o` means for one log.

    Args:
        output: a folder, or a file if there is only one log.
    Raises:
        ExchangeError: a file for several logs, or a file with an unsupported ending.
    """
    if output is None:
        return TrackFiles()
    suffix = output.suffix.lower()
    if output.is_dir() or not suffix:
        stem = log.name.removesuffix(".part").removesuffix(".mcap")
        return TrackFiles(output / f"{stem}.track.parquet", output / f"{stem}.track.svg")
    if suffix not in TABLES + FIGURES:
        raise ExchangeError(
            f"rig track: -o {output}: expected a folder, a table ({', '.join(TABLES)}) or a figure "
            f"({', '.join(FIGURES)})"
        )
    if not alone:
        raise ExchangeError(f"rig track: -o {output}: one file for several logs; give a folder")
    return (
        TrackFiles(table=output, figure=output.with_suffix(".svg")) if suffix in TABLES else TrackFiles(figure=output)
    )


def columns(found: TrackedRun) -> dict[str, NDArray[Any]]:
    """Return the table's columns, all of shape (n,): SI, the unit at the end of each name.

    `std_` is one standard deviation, `low_` and `high_` are 95 % intervals, `smoothed_` is the reference setting's.
    """
    table: dict[str, NDArray[Any]] = {
        "time_s": found.time_s,
        "psi_rad": found.phase_rad,
        "speed_rad_per_s": found.speed_rad_s,
        **_estimates(found, ""),
    }
    if found.smoothed is not None:
        table |= _estimates(found.smoothed, "smoothed_")
    table["trusted"] = found.trusted
    return {name: np.ascontiguousarray(values) for name, values in table.items()}


def _estimates(found: TrackedRun | SmoothedRun, prefix: str) -> dict[str, NDArray[Any]]:
    table: dict[str, NDArray[Any]] = {}
    for j, name in enumerate(STATE_NAMES):
        table[prefix + name], table[f"{prefix}std_{name}"] = found.states[:, j], found.state_std[:, j]
    for j, name in enumerate(_DAMPINGS):
        for what, values in (("", found.values), ("std_", found.std), ("low_", found.low), ("high_", found.high)):
            table[f"{prefix}{what}{name}"] = values[:, j]
    return table


def write_table(place: Path, staging: Staging, found: TrackedRun, facts: Mapping[str, Any]) -> None:
    """Write the steps.

    Args:
        facts: origin of the steps; written to the metadata of a parquet file.
    Raises:
        ExchangeError: the file exists.
    """
    table = columns(found)
    part = staging.place(place)
    if place.suffix.lower() == ".npz":
        with part.open("wb") as file:
            np.savez(file, allow_pickle=False, **table)
        return
    layout = Layout("track", {name: values.dtype for name, values in table.items()})
    format = "parquet" if place.suffix.lower() == ".parquet" else "csv"
    with closing(ArrowFiles([layout], {"track": part}, format)) as writer:
        writer.append("track", table)
        writer.finish(facts)


def picture(result: Tracking) -> TrackedPicture:
    """Return the contents of the figure, with the smoothed motion if there is one."""
    run, found = result.run, result.found
    best = found.smoothed or found
    turns_Hz = float(np.max(np.abs(found.speed_rad_s))) / (2 * math.pi)
    states: list[TrackedState] = []
    for j, name in enumerate(("θ3, °", "θ4, °")):
        states.append(
            TrackedState(
                name,
                found.time_s,
                *_scaled(best, 2 + j, 180 / math.pi),
                run.angle_time_s,
                np.degrees(run.angle_rad[:, j]),
            )
        )
    for j, (name, time, values) in enumerate((("x, mm", run.x_time_s, run.x_m), ("y, mm", run.y_time_s, run.y_m))):
        if len(time):
            value, std = _scaled(best, j, 1e3)
            measured = np.asarray(1e3 * (values - np.nanmean(values)), np.float64)  # the zero of a laser is arbitrary
            states.append(TrackedState(name, found.time_s, value - value.mean(), std, time, measured, turns_Hz))
    dampings: dict[str, list[TrackedDamping]] = {}
    for j, name in enumerate(("c3", "c4")):
        dampings[name] = [
            TrackedDamping("filtered, 95 %", found.time_s, found.values[:, j], found.low[:, j], found.high[:, j])
        ]
        if found.smoothed is not None:
            s = found.smoothed
            dampings[name].append(
                TrackedDamping("smoothed, 95 %", found.time_s, s.values[:, j], s.low[:, j], s.high[:, j])
            )
    known = {name: (k.value, k.low, k.high) for name, k in result.known.items()}
    title = f"{Path(run.source).name}: {run.test}, {result.setting} setting"
    return TrackedPicture(title, states, dampings, found.time_s, found.trusted, known, result.known_text)


def _scaled(found: TrackedRun | SmoothedRun, j: int, factor: float) -> tuple[Array, Array]:
    return factor * found.states[:, j], factor * found.state_std[:, j]


def write_files(result: Tracking, place: TrackFiles, force: bool) -> list[Path]:
    """Write table and figure, both or none; return the files written.

    Args:
        force: replace existing files.
    Raises:
        ExchangeError: a file exists.
        BadFigureName: a figure's ending is not supported.
    """
    with Staging(force) as staging:
        if place.table is not None:
            facts = {**source_facts(Path(result.run.source)), **tracking_json(result)}
            write_table(place.table, staging, result.found, plain(facts))
        if place.figure is not None:
            part = staging.place(place.figure)
            drawn = part.with_suffix(place.figure.suffix)  # matplotlib takes the format from the ending
            try:
                save(drawn, draw_tracked(picture(result)))
                drawn.replace(part)
            finally:
                drawn.unlink(missing_ok=True)
        return staging.commit()
