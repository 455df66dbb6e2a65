"""Commands that exchange data with other programs: export, import."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from rig_basics.texts import number_of
from rig_cli.console import notify, print_json, show
from rig_cli.last_sentence import written_sentence
from rig_cli.option_groups import COLUMNS, LOG_PART, OUTPUT, RECORDING
from rig_cli.options import WHOLE_LOG, Json, LogSpan, Settings
from rig_cli.share_progress import share_progress

if TYPE_CHECKING:
    from daq.exchange.export import Exported
    from daq.exchange.import_recording import Imported


def export(
    log: Path,
    *,
    output: Annotated[Path, Parameter(name=["--output", "-o"], group=OUTPUT)],
    format: Literal["parquet", "csv", "mat", "hdf5"] | None = None,
    channels: Annotated[list[str] | None, Parameter(consume_multiple=True, negative="")] = None,
    span: LogSpan = WHOLE_LOG,
    signals: Annotated[bool, Parameter(negative="")] = False,
    force: Annotated[bool, Parameter(negative="")] = False,
    json: Json = False,
) -> int:
    """Write a log's channels for other programs: parquet, csv, MATLAB/Octave, hdf5.

    The format is the ending of OUTPUT's name. Parquet and csv contain one table per file: several channels become
    OUTPUT-laser_x.csv …; units, provenance, events and losses are in OUTPUT.csv.json next to them. Mat and hdf5 contain
    everything in one file.

    Example: `rig export run.mcap -o run.parquet`

    Parameters
    ----------
    log
        a finished log, or the .part of one that was cut
    output
        file name ending in .parquet, .csv, .mat, .h5 or .hdf5
    format
        the format, if the ending of the name does not state it
    channels
        topics such as laser/x laser/y; with --signals x y angles marks; all that hold samples when not given
    signals
        displacements, angles and index marks on one clock, as identification takes them, instead of the channels
    force
        replace files of that name
    """
    from daq.exchange import export_log  # pyarrow takes a while to import

    with share_progress(f"exporting {log.name}") as progress:
        done = export_log(
            log,
            output,
            format=format,
            channels=channels or (),
            span_s=(span.from_s, span.to_s),
            signals=signals,
            force=force,
            progress=progress,
        )
    for missing in done.missing:
        notify(f"warning: missing from the log: {missing}")
    if json:
        files = [str(file) for file in done.files]
        lost = {"missing": done.missing, "losses": done.losses}
        print_json({"log": str(log), "format": done.format, "files": files, "rows": done.rows, **lost})
        return 0
    _print_export(done)
    return 0


def _print_export(done: Exported) -> None:
    for name, count in done.rows.items():
        show(f"{name:10} {number_of(count, 'sample', form='9d')}")
    if len(done.files) > 1:
        for file in done.files:
            notify(f"written to {file}")
    show(written_sentence("exported", done.rows, len(done.missing), done.files))


@Parameter(name="*", group=COLUMNS)
@dataclass(frozen=True)
class ImportColumns:
    """Columns of the recording, as NAME:UNIT.

    Attributes:
        time: column of sample times, from the recording's start or since 1970
        rate_Hz: rows per second without a column of times
        x: displacement of the disk's centre along x
        y: displacement of the disk's centre along y
        theta3: angle of pendulum A relative to the rotor
        theta4: angle of pendulum B relative to the rotor
        phase: rotor angle in every row, unwrapped or not; 0: the imbalance points along +x
        marks: times at which the index mark passed: a column, or a file of its own, MARKS.csv:s
        speed: rotor speed; integrated to a phase without an absolute reference
    """

    time: str | None = None
    rate_Hz: Annotated[float | None, Parameter(name="--rate")] = None
    x: str | None = None
    y: str | None = None
    theta3: str | None = None
    theta4: str | None = None
    phase: str | None = None
    marks: str | None = None
    speed: str | None = None


@Parameter(name="*", group=RECORDING)
@dataclass(frozen=True)
class ImportFacts:
    """What the file does not contain about its recording.

    Attributes:
        test: ring-down-x, ring-down-y, spin-down, run-up, point-NAME
        point: a validation point; the same as --test point-NAME
        note: the operator's note
        start: when the recording's time was 0, such as 2026-03-01T10:00:00; UTC without a zone
        release: when the pendulums were released, s; A,B if they differ
        counts_per_revolution: of the encoders, if it differs from the rig file's
        invalid: values that mean "no reading", as they are in the file, separated by commas
        clock_tolerance_ppm: standard uncertainty of the rate of the recording's clock, such as 0.1 for one disciplined
            by GPS; default: the rig file's clock_tolerance_ppm, or 50
        recorder: name of the recorder; files of one recorder share its clock's error, and so do files without a name
        decimal: decimal sign of a text file, . or , if it cannot be found; the other one separates thousands
        from_s: beginning of the part that is imported, in the recording's time, s
        to_s: its end, s
    """

    test: str = ""
    point: str = ""
    note: str = ""
    start: str | None = None
    release: Annotated[str | None, Parameter(allow_leading_hyphen=True)] = None
    counts_per_revolution: int | None = None
    invalid: Annotated[str | None, Parameter(allow_leading_hyphen=True)] = None
    clock_tolerance_ppm: float | None = None
    recorder: str = ""
    decimal: Literal[".", ","] | None = None
    from_s: Annotated[float | None, Parameter(name="--from", group=LOG_PART, allow_leading_hyphen=True)] = None
    to_s: Annotated[float | None, Parameter(name="--to", group=LOG_PART, allow_leading_hyphen=True)] = None


_NO_COLUMNS, _NO_FACTS = ImportColumns(), ImportFacts()


def import_(
    file: Path,
    *,
    output: Annotated[Path, Parameter(name=["--output", "-o"], group=OUTPUT)],
    rig: str,
    columns: ImportColumns = _NO_COLUMNS,
    facts: ImportFacts = _NO_FACTS,
    settings: Settings = None,
    json: Json = False,
) -> int:
    """Make a log of a csv, parquet, mat or hdf5 file recorded elsewhere.

    Columns are named NAME:UNIT, for example --time t:ms --x disp1:mm --y disp2:-um --theta3 ch4:deg. NAME is the
    column's name or its number from 1, in mat and hdf5 a path (data.x, data.2). UNIT is s ms us ns min, m mm um nm in,
    rad deg rev, rad/s rpm Hz deg/s, with a minus sign for an axis that points the other way, or a number that turns
    the value into m, rad, s or rad/s; it may be left out if the name ends in it (displacement_m). A column with
    times of its own is NAME:UNIT@TIME:UNIT. Empty cells are not samples; gaps are counted and never filled.

    Example: `rig import old.csv -o old.mcap --rig my.toml --test ring-down-x --time t:ms --x disp1:mm`

    Parameters
    ----------
    file
        the recording; delimiter, decimal comma, comments and header of a csv are detected
    output
        the log, ending in .mcap
    rig
        rig file or its name; its snapshot goes into the log
    """
    from daq.exchange import import_recording, make_recipe
    from daq.exchange.recipe import parse_numbers
    from rig_configs import load_rig

    known = {name: value for name, value in asdict(facts).items() if name not in ("release", "invalid")}
    recipe = make_recipe(
        **asdict(columns),
        **known,
        release_s=parse_numbers(facts.release, "release") if facts.release else (),
        invalid=parse_numbers(facts.invalid, "invalid") if facts.invalid else (),
    )
    with share_progress(f"importing {file.name}") as progress:
        done = import_recording(file, output, load_rig(rig, settings=settings or []), recipe, progress)
    for warning in done.warnings:
        notify(f"warning: {warning}")
    if json:
        print_json(
            {
                "log": str(done.path),
                "samples": done.samples,
                "invalid": done.invalid,
                "gaps": done.gaps,
                "start_ns": done.start_ns,
                "end_ns": done.end_ns,
                "warnings": done.warnings,
            }
        )
        return 0
    _print_import(done)
    return 0


def _print_import(done: Imported) -> None:
    for topic, count in done.samples.items():
        show(f"{topic:10} {number_of(count, 'sample', form='9d')}")
    for device, count in done.invalid.items():
        show(
            f"{device:10} {number_of(count, 'invalid reading', form='9d')}, "
            f"{number_of(done.gaps.get(device, 0), 'sample')} in gaps"
        )
    show(written_sentence("imported", done.samples, 0, [done.path]))
