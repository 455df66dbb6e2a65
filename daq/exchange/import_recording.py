"""Import of a csv, parquet, mat or hdf5 recording into a log.

    import_recording("pluck.csv", "pluck.mcap", load_rig("my.toml"),
                     make_recipe(test="ring-down-x", time="t:ms", x="disp1:mm", y="disp2:mm"))

The log has no raw bytes. Its samples have the recording's own times, and the attachment `import.json` contains the
source file (name, SHA-256, size) and the options. Nothing is interpolated: a gap stays a gap and is counted, an invalid
reading stays NaN.

Only numbers in the file itself are read. Rejected, with a message that contains the reason:

    any file        more than 4 GB unpacked, or more than 256 MB and a hundred times its size on the disk
    HDF5            datasets in other files, virtual datasets, plug-in filters (h5repack makes a plain file); more than
                    10 000 groups and datasets, or 64 levels; links to other files are not columns
    MAT             parts that exceed each other's ends, have no valid type or are nested more than 64 deep
    parquet, text   a column of texts or lists; a line of more than a million characters
    any column      complex numbers, texts, three dimensions, a link

A test that the table of test kinds does not list is imported with a warning. A ring-down recorded by one sensor gives
its direction.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from daq.exchange.columns import ColumnFile
from daq.exchange.errors import ExchangeError
from daq.exchange.imported_log import ImportFindings, Part, gap_events, make_parts, release_events, write_log
from daq.exchange.provenance import iso_time
from daq.exchange.readings import LEAST_ROWS, SensorReadings, since_1970
from daq.exchange.recipe import Recipe
from daq.exchange.recordings import open_recording
from daq.exchange.sensors import marks_file, read_sensors
from daq.guided_test_kinds import KINDS, kind_of, point_of
from daq.log.time_span import TimeSpan
from daq.log.verdicts import digest_of
from daq.signals.run_clocks import ASSUMED_TOLERANCE_PPM
from daq.version import software_version
from rig_basics.texts import storable
from rig_configs.schema import Rig

UNKNOWN_START_NS = 946_684_800_000_000_000
"""2000-01-01: start of recordings whose date is unknown."""


@dataclass(frozen=True)
class Imported:
    """Result of an import.

    Attributes:
        path: the log.
        samples: number of samples by topic.
        invalid: number of readings that the recording marks as invalid, by device.
        gaps: number of samples missing in a uniformly sampled recording, by device; absent if it is not uniform.
        start_ns, end_ns: first and last sample, ns since 1970.
        warnings: warnings, as sentences.
    """

    path: Path
    samples: Mapping[str, int]
    invalid: Mapping[str, int]
    gaps: Mapping[str, int]
    start_ns: int
    end_ns: int
    warnings: list[str]


def import_recording(
    path: str | Path,
    out: str | Path,
    rig: Rig,
    recipe: Recipe,
    progress: Callable[[float], None] | None = None,
) -> Imported:
    """Make a log from a file recorded by another program.

    Args:
        path: a csv (any delimiter, decimal comma, comments above), parquet, mat or hdf5 file.
        out: name of the log, ending in .mcap; an existing log is not overwritten.
        rig: the rig it was recorded on; its snapshot is attached to the log.
        recipe: assignment of the columns, see `make_recipe`.
        progress: called with the completed share, 0 … 1.

    Raises:
        ExchangeError: missing columns, values that are not numbers, times that do not increase, implausible units; the
            message contains the line. No log is left.
        LogError: the log's name is taken or does not end in .mcap.
        RecordingError, OSError: the log cannot be written.

    Example:
        >>> import tempfile
        >>> from pathlib import Path
        >>> import numpy as np
        >>> from daq import import_recording, load_run, make_recipe
        >>> from rig_configs import load_rig
        >>> time = np.arange(0.0, 2.0, 1e-3)
        >>> table = np.column_stack([time, 2.0 * np.exp(-0.4 * time) * np.cos(19.0 * time)])
        >>> recipe = make_recipe(test="ring-down-x", time="t:s", x="x:mm")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     csv, log = Path(folder, "decay.csv"), Path(folder, "decay.mcap")
        ...     np.savetxt(csv, table, delimiter=",", header="t,x", comments="")
        ...     imported = import_recording(csv, log, load_rig("virtual"), recipe)
        ...     run = load_run(log)
        >>> run.test, len(run.x_m), run.x_m[0].item()
        ('ring-down-x', 2000, 0.002)
    """
    recording = open_recording(Path(path), recipe.decimal)
    noticed = ImportFindings(devices=rig.roles.device_of)
    readings = _cut_out(read_sensors(recording, recipe, rig, noticed.warnings), recipe.span)
    start_ns, is_known = _start(readings, recipe)
    if not is_known:
        noticed.warnings.append(f"no start time: times count from {iso_time(start_ns)}, which is not the real date")
    parts = make_parts({name: found.shifted(start_ns) for name, found in readings.items()}, recipe, noticed)
    first, last = min(int(part.time_ns[0]) for part in parts), max(int(part.time_ns[-1]) for part in parts)
    releases = release_events(parts, recipe.release_s, start_ns or first, noticed.device("pendulums"))
    events = sorted([*gap_events(parts, noticed), *releases], key=lambda event: event.facts["time_ns"])
    noticed.warnings += _remarks({part.channel.topic for part in parts}, recipe)
    clock = recorder_clock(recipe.clock_tolerance_ppm, recipe.recorder, rig, {part.channel.topic for part in parts})
    noticed.warnings += [clock.warning] if clock.warning else []
    facts = {**_facts(recording, rig, recipe, clock), **({"started": iso_time(first)} if is_known else {})}
    attachments = _attachments(recording, rig, recipe, noticed)
    summary = {"losses": _losses(parts, noticed), "warnings": noticed.warnings}
    log = write_log(Path(out), parts, events, facts, attachments, summary, progress or (lambda _: None))
    samples = {part.channel.topic: len(part.time_ns) for part in parts}
    return Imported(log, samples, noticed.invalid, noticed.gaps, first, last, noticed.warnings)


def _cut_out(readings: Mapping[str, SensorReadings], span: TimeSpan) -> dict[str, SensorReadings]:
    """Return the readings of a part of the recording, s since its time 0, or since its start if times count from 1970.

    Raises:
        ExchangeError: a sensor has too few samples in the part.
    """
    if span.is_whole:
        return dict(readings)
    first = min(int(found.time_ns[0]) for found in readings.values() if len(found.time_ns))
    last = max(int(found.time_ns[-1]) for found in readings.values() if len(found.time_ns))
    zero = first if any(since_1970(found.time_ns) for found in readings.values()) else 0
    part = {name: found.within(*span.ns(zero)) for name, found in readings.items()}
    for name, found in part.items():
        if len(found.time_ns) < LEAST_ROWS and name != "marks":
            raise ExchangeError(
                f"{name}: expected at least {LEAST_ROWS} samples from {span}, got {len(found.time_ns)}; the recording "
                f"lasts from {(first - zero) / 1e9:g} s to {(last - zero) / 1e9:g} s"
            )
    return {name: found for name, found in part.items() if len(found.time_ns)}


def _start(readings: Mapping[str, SensorReadings], recipe: Recipe) -> tuple[int, bool]:
    """Return time 0 of the recording in ns since 1970 (0 if its times count from 1970), and whether it is known."""
    since = {name: since_1970(found.time_ns) for name, found in readings.items()}
    if not any(since.values()):
        start = recipe.start_ns
        return (UNKNOWN_START_NS, False) if start is None else (start, True)
    if not all(since.values()):
        some = ", ".join(name for name, value in since.items() if value)
        raise ExchangeError(f"expected all times to count from one zero, but those of {some} count from 1970")
    if recipe.start is not None:
        raise ExchangeError("expected no start time: the times in the file count from 1970 already")
    return 0, True


def _remarks(topics: set[str], recipe: Recipe) -> list[str]:
    """Return warnings about missing data for the identification or validation of the test."""
    test = recipe.test_name
    found: list[str] = []
    kind = kind_of(test)
    if kind is None:
        known = ", ".join(name for name, row in KINDS.items() if row.gives)
        found.append(f"{test}: not in the table of test kinds, so `rig identify` skips it; the table contains {known}")
    elif lacking := sorted(kind.channels - topics):
        found.append(f"{test}: needs {', '.join(sorted(kind.channels))}; missing: {', '.join(lacking)}")
    if point_of(test) and not recipe.release_s:
        found.append(f"{test}: no time of release, so the time after the release cannot be separated from the rest")
    return found


def _losses(parts: list[Part], noticed: ImportFindings) -> dict[str, dict[str, int]]:
    devices = sorted({noticed.device(part.channel.topic) for part in parts})
    return {name: {"samples": noticed.gaps.get(name, 0), "invalid": noticed.invalid.get(name, 0)} for name in devices}


def _facts(recording: ColumnFile, rig: Rig, recipe: Recipe, clock: RecorderClock) -> dict[str, str]:
    facts = {
        "rig": rig.name,
        "software": software_version(),
        **clock.facts,
        "test": recipe.test_name,
        "note": recipe.note,
        "origin": f"{recording.path.name} {digest_of(recording.path)}",
    }
    if point := point_of(recipe.test_name):
        facts["point"] = point
    if recipe.speed:
        facts["phase_reference"] = "none"
    return facts


def _attachments(recording: ColumnFile, rig: Rig, recipe: Recipe, noticed: ImportFindings) -> dict[str, bytes]:
    if recipe.counts_per_revolution is not None:
        rig = _with_counts(rig, recipe.counts_per_revolution)
    paths = [recording.path, *([marks] if (marks := marks_file(recipe)) else [])]
    made_of = {
        "files": [
            {"name": p.name, "sha256": digest_of(p).removeprefix("sha256:"), "bytes": p.stat().st_size} for p in paths
        ],
        "columns": list(recording.names),
        "options": recipe.model_dump(mode="json"),
        "software": software_version(),
        "warnings": noticed.warnings,
    }
    text = json.dumps(made_of, ensure_ascii=False, indent=1)
    return {
        "rig.json": rig.snapshot_json(),
        "roles.json": rig.roles_json(),
        "identities.json": b"{}",
        "import.json": storable(text).encode(),
    }


def _with_counts(rig: Rig, counts_per_revolution: int) -> Rig:
    """Return the rig with other encoders."""
    if rig.roles.angles is None:
        raise ExchangeError(f"counts_per_revolution: rig {rig.name} has no device that measures the pendulums' angles")
    name = rig.roles.angles.device
    encoder = rig.devices[name].model_copy(update={"counts_per_revolution": counts_per_revolution})
    return rig.model_copy(update={"devices": {**rig.devices, name: encoder}})


_TOLERANCE = "clock_tolerance_ppm"


@dataclass(frozen=True)
class RecorderClock:
    """Clock of a recording.

    Attributes:
        tolerance_ppm: relative standard uncertainty of its rate, ppm.
        basis: source of the tolerance: "stated", "rig file" or "assumed".
        recorder: the operator's name for the recorder; "" if none was given.
    """

    tolerance_ppm: float
    basis: str
    recorder: str = ""

    @property
    def facts(self) -> dict[str, str]:
        """Facts for the log."""
        facts = {"clock_tolerance_ppm": repr(self.tolerance_ppm), "clock_tolerance_from": self.basis}
        return facts | ({"recorder": self.recorder} if self.recorder else {})

    @property
    def warning(self) -> str | None:
        """Warning about an assumed tolerance."""
        if self.basis != "assumed":
            return None
        return (
            f"the recorder's clock is assumed to be accurate to {self.tolerance_ppm:g} ppm (one standard deviation): "
            "neither the rig file nor the import states its accuracy"
        )


def recorder_clock(stated_ppm: float | None, recorder: str, rig: Rig, topics: Iterable[str]) -> RecorderClock:
    """Return the clock of a file.

    Args:
        stated_ppm: tolerance stated by the operator, ppm; None if not stated.
        recorder: the operator's name for the recorder, or "".
        rig: rig file, which may state the tolerances of the devices' clocks.
        topics: channels in the file; the largest tolerance of the devices that fill them is used.
    """
    if stated_ppm is not None:
        return RecorderClock(stated_ppm, "stated", recorder)
    filled, wanted = rig.roles.device_of, set(topics)
    devices = [rig.devices[device] for device in sorted({filled[topic] for topic in wanted if topic in filled})]
    stated = [float(getattr(d, _TOLERANCE)) for d in devices if _TOLERANCE in d.model_fields_set]
    if stated and len(stated) == len(devices) and wanted <= filled.keys():
        return RecorderClock(max(stated), "rig file", recorder)
    return RecorderClock(max([ASSUMED_TOLERANCE_PPM, *stated]), "assumed", recorder)
