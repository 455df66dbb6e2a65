"""Export of a log's channels, or of the signals of its run, to files of other programs.

    export_log("run.mcap", "run.h5")                                      # every channel, one file
    export_log("run.mcap", "x.csv", channels=["laser/x"], span_s=(2.0, 5.0))
    export_log("run.mcap", "run.mat", signals=True)                       # x, y, angles, marks on the common clock

Parquet and CSV contain one table per file: several channels become OUT-CHANNEL.csv … and a file OUT.csv.json. No file
gets its final name before all are written.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

from daq.exchange.arrow_files import ArrowFiles
from daq.exchange.errors import ExchangeError
from daq.exchange.hdf5_file import Hdf5File
from daq.exchange.mat_file import MatFile
from daq.exchange.provenance import iso_time, log_facts, source_facts
from daq.exchange.staging import Staging
from daq.exchange.tables import Layout, TableWriter, sample_columns, sample_layout, signal_tables
from daq.log import Log, open_log
from daq.log.time_span import TimeSpan
from daq.signals.run import Run, load_run
from rig_basics.texts import storable

Format = Literal["parquet", "csv", "mat", "hdf5"]
_SUFFIXES: Mapping[str, Format] = {".parquet": "parquet", ".csv": "csv", ".mat": "mat", ".h5": "hdf5", ".hdf5": "hdf5"}
_ROWS = 500_000  # approximate number of samples in memory
_SUFFIX_OF: Mapping[Format, str] = {"parquet": ".parquet", "csv": ".csv", "mat": ".mat", "hdf5": ".h5"}

Progress = Callable[[float], None]


@dataclass(frozen=True)
class Exported:
    """Result of an export.

    Attributes:
        files: files in the order of creation; the provenance's .json is the last.
        format: format of the files.
        rows: number of rows by channel or signal.
        missing: missing parts of the log, as sentences; empty for a complete log.
        losses: counts by device and kind.
    """

    files: list[Path]
    format: Format
    rows: dict[str, int]
    missing: list[str]
    losses: Mapping[str, Mapping[str, int]]


def export_log(
    path: str | Path,
    out: str | Path,
    *,
    format: Format | None = None,
    channels: Sequence[str] = (),
    span_s: tuple[float | None, float | None] = (None, None),
    signals: bool = False,
    force: bool = False,
    progress: Progress | None = None,
) -> Exported:
    """Write a log's channels, or its run's signals, to files of another format.

    Args:
        path: a log, finished or not.
        out: file name; parquet and csv put a channel's name after its stem when there are several.
        format: None: from the ending of the name.
        channels: topics; empty: every channel with samples. With `signals` x, y, angles, marks.
        span_s: begin and end, s since the log's start: samples with begin ≤ t < end; None is open.
        signals: export the signals of `daq.signals.run.load_run`, on one clock, instead of the channels.
        force: replace existing files of these names.
        progress: called with the completed share, 0 … 1.

    Raises:
        ExchangeError: nothing to export, an unknown format, a name that is taken, a table too large for the format.
        LogError: the file is not a readable log; ChannelMissing for a missing channel.
        OSError: the disk is full or gone; no file is left.
    """
    path, out = Path(path), Path(out)
    chosen = _format(out, format)
    window = TimeSpan(*span_s)
    with open_log(path) as log, Staging(force) as staging:
        job = _Job(log, chosen, out if out.suffix else out.with_suffix(_SUFFIX_OF[chosen]), staging, window)
        rows, facts = job.signals(load_run(path), channels) if signals else job.channels(channels, progress)
        return Exported(staging.commit(), chosen, rows, facts["missing"], facts["losses"])


@dataclass(frozen=True)
class _Job:
    """One export."""

    log: Log
    format: Format
    out: Path
    staging: Staging
    window: TimeSpan

    def channels(self, wanted: Sequence[str], progress: Progress | None) -> tuple[dict[str, int], dict[str, Any]]:
        """Export sample channels in slices; return the number of rows by topic, and the provenance."""
        log = self.log
        topics = list(dict.fromkeys(wanted)) or [topic for topic in log if log.count(topic)]
        if not topics:
            raise ExchangeError(f"{log.path}: expected samples to export, the log contains none")
        layouts = [sample_layout(log, topic) for topic in topics]
        rows = dict.fromkeys(topics, 0)
        source = source_facts(log.path)
        total = max(1, sum(log.count(topic) for topic in topics))
        with closing(self._writer(layouts)) as writer:
            for topic in topics:
                for part in self._part.parts(topic, _ROWS):
                    columns = sample_columns(part, log.start_ns)
                    rows[topic] += len(columns["time_ns"])
                    writer.append(topic, columns)
                    if progress is not None:
                        progress(min(1.0, sum(rows.values()) / total))
            facts = {**log_facts(log), **source, **_window_facts(self.window, log.start_ns), "rows": rows}
            self._finish(writer, layouts, facts)
        return rows, facts

    def signals(self, run: Run, wanted: Sequence[str]) -> tuple[dict[str, int], dict[str, Any]]:
        """Export the run's signals; return the number of rows by name, and the provenance."""
        tables = signal_tables(run, self.window.from_s, self.window.to_s)
        unknown = sorted(set(wanted) - set(tables))
        if unknown:
            raise ExchangeError(f"expected signals of {', '.join(tables)}, got {', '.join(unknown)}")
        names = list(dict.fromkeys(wanted)) or [name for name, table in tables.items() if len(table["time_s"])]
        if not names:
            raise ExchangeError(f"{run.source}: expected signals to export, the run has none in this time window")
        layouts = [Layout(n, {c: values.dtype for c, values in tables[n].items()}) for n in names]
        rows = {name: len(tables[name]["time_s"]) for name in names}
        facts = {
            **log_facts(self.log),
            **source_facts(self.log.path),
            **_window_facts(self.window, round(run.start_s * 1e9)),
            "rows": rows,
            "releases": [vars(release) for release in run.releases],
            "angle_step_rad": run.angle_step_rad,
            "clock_rate_std": dict(run.clock_rate_std),
            "clock_shared_std": dict(run.clock_shared_std),
        }
        with closing(self._writer(layouts)) as writer:
            for name in names:
                writer.append(name, tables[name])
            self._finish(writer, layouts, facts)
        return rows, facts

    def _writer(self, layouts: Sequence[Layout]) -> TableWriter:
        if self.format == "hdf5":
            return Hdf5File(layouts, self.staging.place(self.out))
        if self.format == "mat":
            return MatFile(layouts, self.staging.place(self.out))
        places = {layout.name: self.staging.place(self._file(layout, len(layouts))) for layout in layouts}
        self.staging.place(self._sidecar)  # raises before the work if the name is taken
        return ArrowFiles(layouts, places, self.format)

    @property
    def _part(self) -> Log:
        """The log, limited to the window."""
        return self.log if self.window.is_whole else self.log.between(*self.window.ns(self.log.start_ns))

    @property
    def _sidecar(self) -> Path:
        return self.out.with_name(f"{self.out.name}.json")

    def _file(self, layout: Layout, tables: int) -> Path:
        return self.out if tables == 1 else self.out.with_stem(f"{self.out.stem}-{layout.plain_name}")

    def _finish(self, writer: TableWriter, layouts: Sequence[Layout], facts: dict[str, Any]) -> None:
        notes = {"events": self._part.events, "health": self._part.health}
        if self.format in ("mat", "hdf5"):
            writer.finish({**facts, **notes})
            return
        writer.finish(facts)
        units = {layout.name: layout.units for layout in layouts}
        files = {layout.name: self._file(layout, len(layouts)).name for layout in layouts}
        text = json.dumps({**facts, "files": files, "units": units, **notes}, ensure_ascii=False, indent=1)
        self.staging.place(self._sidecar).write_text(storable(text), encoding="utf-8")


def _window_facts(window: TimeSpan, start_ns: int) -> dict[str, Any]:
    """Return the facts of a window for the provenance; an open end is None."""
    return {
        "time_s_counts_from": iso_time(start_ns),
        "time_s_counts_from_ns": start_ns,
        "window_from_s": window.from_s,
        "window_to_s": window.to_s,
    }


def _format(out: Path, format: Format | None) -> Format:
    if format is None and out.suffix.lower() not in _SUFFIXES:
        raise ExchangeError(f"{out}: expected a name ending in {', '.join(_SUFFIXES)}, or a format")
    if format not in (None, *get_args(Format)):
        raise ExchangeError(f"expected a format of {', '.join(get_args(Format))}, got {format!r}")
    return format or _SUFFIXES[out.suffix.lower()]
