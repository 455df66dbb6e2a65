"""A log in other programs' formats: an independent reader finds the contents of the log."""

from __future__ import annotations

import csv
import errno
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow.parquet as pq
import pytest
from scipy.io import loadmat

from daq.channels import LASER_X, LASER_Y, MOTOR, PENDULUMS, TACHO
from daq.exchange import ExchangeError, export, export_log, mat_file
from daq.exchange.units import unit_of
from daq.items import Batch, DeviceEvent
from daq.log import open_log
from daq.log.file import LogFile
from daq.signals.run import load_run
from rig_configs import load_rig
from tests.daq.small_log import write_small_log

START = 1_700_000_000_123_456_789
FORMATS = ("parquet", "csv", "mat", "hdf5")
AWKWARD = [np.nan, 0.1, -0.0, 5e-324, 1.7976931348623157e308, 1 / 3, 1e22, -1e-7, 123456789.123456789]

Tables = dict[str, dict[str, np.ndarray]]


@pytest.fixture
def log_path(tmp_path: Path) -> Path:
    """Two channels with numbers that are easily rounded, one empty channel; an event and a report."""
    path = tmp_path / "run.mcap"
    facts = {"rig": "mine", "test": "ring-down-x", "note": "µ “quoted”, with commas\nand lines", "started": "then"}
    attachments = {"rig.json": load_rig("virtual").snapshot_json(), "identities.json": b'{"laser_x": {"serial": "7"}}'}
    rng = np.random.default_rng(1)
    with LogFile(path, facts, attachments, (), START, (LASER_X, PENDULUMS, TACHO)) as log:
        for block in range(10):
            time = START + 250_000 * (np.arange(100) + 100 * block)
            value = rng.normal(size=100)
            value[: len(AWKWARD)] = AWKWARD
            ticks = rng.integers(0, 2**64, 100, np.uint64, endpoint=False)
            sequence = (np.arange(100) + 2**32 - 50).astype(np.uint32)
            columns = {
                "displacement_m": value,
                "code": np.full(100, 2**32 - 1),
                "counter": np.arange(100),
                "device_ticks": ticks,
                "flags": np.zeros(100, np.uint32),
            }
            log.batch(Batch(LASER_X, time, sequence, columns), int(time[-1]) + 7)
            angles = {
                "theta3_rad": value[:20],
                "theta4_rad": value[20:40],
                "count_a": np.full(20, -(2**31)),
                "count_b": np.arange(20),
                "index": np.arange(20),
                "node_time_us": ticks[:20],
                "flags": np.arange(20),
            }
            log.batch(Batch(PENDULUMS, time[::5], np.arange(20, dtype=np.uint32), angles), int(time[-1]) + 9)
            log.flush()
        log.event(DeviceEvent("gap", "laser_x", "3 samples lost", {"samples": 3}), START + 5_000_000)
        log.note("health", {"kind": "health", "losses": {}}, START + 6_000_000, START + 6_000_000)
        return log.finish({"losses": {"laser_x": {"samples": 3}}})


def truth(path: Path) -> Tables:
    with open_log(path) as log:
        return {
            topic: {
                "time_ns": log[topic].time_ns,
                "log_time_ns": log[topic].log_time_ns,
                "sequence": log[topic].sequence,
                **log[topic].columns,
            }
            for topic in log
            if log.count(topic)
        }


def files_by_table(files: list[Path], names: list[str]) -> dict[str, Path]:
    data = [file for file in files if file.suffix != ".json"]
    if len(names) == 1:
        return {names[0]: data[0]}
    return {name: next(f for f in data if f.stem.endswith("-" + name.replace("/", "_"))) for name in names}


def read_csv(files: list[Path], names: list[str]) -> Tables:
    found: Tables = {}
    for name, file in files_by_table(files, names).items():
        with open(file, newline="", encoding="ascii") as stream:
            header, *rows = list(csv.reader(stream))
        columns: dict[str, list[str]] = {key: [row[i] for row in rows] for i, key in enumerate(header)}
        found[name] = {
            key: np.array(list(map(float if "." in "".join(values) else int, values)), object)
            for key, values in columns.items()
        }
    return found


def read_parquet(files: list[Path], names: list[str]) -> Tables:
    tables_ = {name: pq.read_table(file) for name, file in files_by_table(files, names).items()}
    return {name: {c: t.column(c).to_numpy() for c in t.column_names} for name, t in tables_.items()}


def read_mat(files: list[Path], names: list[str]) -> Tables:
    found = loadmat(files[0], simplify_cells=True)
    return {name: {k: np.atleast_1d(v) for k, v in found[name.replace("/", "_")].items()} for name in names}


def read_hdf5(files: list[Path], names: list[str]) -> Tables:
    with h5py.File(files[0]) as file:
        return {name: {column: file[name][column][()] for column in file[name]} for name in names}


READERS: dict[str, Callable[[list[Path], list[str]], Tables]] = {
    "csv": read_csv,
    "parquet": read_parquet,
    "mat": read_mat,
    "hdf5": read_hdf5,
}


def assert_same(found: dict[str, np.ndarray], expected: dict[str, np.ndarray]) -> None:
    for name, values in expected.items():
        got = found[name]
        if values.dtype.kind == "f":
            got = got.astype(np.float64)  # a csv column may contain whole numbers only
            nan = np.isnan(values)
            assert np.array_equal(np.isnan(got), nan), name
            assert np.array_equal(got[~nan].view(np.uint64), values[~nan].view(np.uint64)), name
        else:
            assert [int(v) for v in got] == [int(v) for v in values], name


@pytest.mark.parametrize("rows_per_slice", [10**6, 70])
@pytest.mark.parametrize("format", FORMATS)
def test_an_independent_reader_finds_the_log_bit_for_bit(
    log_path: Path, format: Any, rows_per_slice: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(export, "_ROWS", rows_per_slice)
    shares: list[float] = []
    out = log_path.with_name(f"out.{format}")
    done = export_log(log_path, out, format=format, progress=shares.append)
    expected = truth(log_path)
    assert done.rows == {"laser/x": 1000, "pendulums": 200}  # tacho is empty
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert len(shares) > (10 if rows_per_slice == 70 else 1)
    found = READERS[format](done.files, list(expected))
    for name, columns in expected.items():
        assert_same(found[name], columns)
        seconds = (columns["time_ns"] - (START + 5_000_000)) / 1e9  # the event is the log's first message
        assert np.array_equal(found[name]["time_s"].astype(float), seconds)
    assert not list(log_path.parent.glob("*.part"))


@pytest.mark.parametrize("format", FORMATS)
def test_units_and_provenance_go_with_the_numbers(log_path: Path, format: Any) -> None:
    done = export_log(log_path, log_path.with_name("out"), format=format, span_s=(-1.0, 0.1))
    if format == "hdf5":
        with h5py.File(done.files[0]) as file:
            facts: dict[str, Any] = json.loads(file["provenance"][()])
            facts |= {name: json.loads(file[name][()]) for name in ("events", "health")}
            units = {name: data.attrs["units"] for name, data in file["laser/x"].items()}
            assert file.attrs["rig"] == "mine"
    elif format == "mat":
        found = loadmat(done.files[0], simplify_cells=True)
        facts, units = found["provenance"], found["units"]["laser_x"]
        facts = {k: json.loads(v) if isinstance(v, str) and v[:1] in "[{" else v for k, v in facts.items()}
    else:
        facts = json.loads(next(f for f in done.files if f.suffix == ".json").read_text(encoding="utf-8"))
        units = facts["units"]["laser/x"]
    if format == "parquet":
        metadata = pq.read_schema(done.files[0]).metadata
        assert json.loads(metadata[b"units"]) == units
        assert json.loads(metadata[b"provenance"])["source_sha256"] == facts["source_sha256"]
    assert units["displacement_m"] == "m"
    assert units["time_ns"] == "ns"
    assert units["counter"] == "count"
    assert (facts["rig"], facts["test"], facts["source"]) == ("mine", "ring-down-x", "run.mcap")
    assert facts["note"] == "µ “quoted”, with commas\nand lines"
    assert facts["rig_snapshot"]["suspension"]["k1_N_per_m"] == load_rig("virtual").suspension.k1_N_per_m
    assert facts["identities"] == {"laser_x": {"serial": "7"}}
    assert facts["losses"] == {"laser_x": {"samples": 3}}
    assert (facts["window_from_s"], facts["window_to_s"]) == (-1.0, 0.1)
    assert facts["events"][0]["samples"] == 3
    assert len(facts["health"]) == 1
    assert len(facts["source_sha256"]) == 64
    assert bool(facts["complete"])


def test_units_of_every_field_the_rig_logs() -> None:
    fields = {name for channel in (LASER_X, LASER_Y, PENDULUMS, TACHO, MOTOR) for name in channel.names}
    assert {name: unit_of(name) for name in fields} == {
        "displacement_m": "m",
        "code": "1",
        "counter": "count",
        "device_ticks": "count",
        "theta3_rad": "rad",
        "theta4_rad": "rad",
        "count_a": "count",
        "count_b": "count",
        "index": "1",
        "node_time_us": "us",
        "flags": "1",
        "revolutions": "count",
        "speed_rpm": "rpm",
        "target_rpm": "rpm",
        "statusword": "1",
    }


def test_one_channel_in_a_span_of_time(log_path: Path) -> None:
    done = export_log(log_path, log_path.with_name("x.csv"), channels=["laser/x"], span_s=(0.05, 0.1))
    assert [file.name for file in done.files] == ["x.csv", "x.csv.json"]
    time = read_csv(done.files, ["laser/x"])["laser/x"]["time_s"]
    with open_log(log_path) as log:
        whole = (log["laser/x"].time_ns - log.start_ns) / 1e9
    assert np.array_equal(time.astype(float), whole[(whole >= 0.05) & (whole < 0.1)])
    assert len(time) == 200


@pytest.mark.parametrize("format", FORMATS)
def test_signals_are_those_of_load_run(tmp_path: Path, format: Any) -> None:
    path = write_small_log(tmp_path / "small.mcap", steps=30, opened_at=10, reported=(0, 1))
    run = load_run(path)
    done = export_log(path, tmp_path / f"signals.{format}", format=format, signals=True)
    found = READERS[format](done.files, ["x", "y", "angles", "marks"])
    assert_same(found["x"], {"time_s": run.x_time_s, "displacement_m": run.x_m})
    assert_same(found["angles"], {"time_s": run.angle_time_s, "theta4_rad": run.angle_rad[:, 1]})
    assert_same(found["marks"], {"time_s": run.mark_time_s, "phase_rad": run.mark_phase_rad})
    if format == "hdf5":
        with h5py.File(done.files[0]) as file:
            releases = json.loads(file["provenance"][()])["releases"]
        assert [r["time_s"] for r in releases] == [r.time_s for r in run.releases]


@pytest.mark.parametrize("format", FORMATS)
def test_what_is_interrupted_leaves_nothing(log_path: Path, format: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(export, "_ROWS", 100)
    before = set(log_path.parent.iterdir())

    def stop(share: float) -> None:
        if share > 0.5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        export_log(log_path, log_path.with_name("out"), format=format, progress=stop)
    assert set(log_path.parent.iterdir()) == before


@pytest.mark.skipif(sys.platform == "win32", reason="only POSIX limits the size of a file")
def test_a_full_disk_is_an_error_and_leaves_nothing(log_path: Path) -> None:
    before = set(log_path.parent.iterdir())
    script = (
        "import resource, signal, sys\n"
        "from daq.exchange import export_log\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "hard = resource.getrlimit(resource.RLIMIT_FSIZE)[1]\n"
        "for case in sys.argv[3:]:\n"
        "    resource.setrlimit(resource.RLIMIT_FSIZE, (int(case.split(':')[1]), hard))\n"
        "    try:\n"
        "        export_log(sys.argv[1], sys.argv[2], format=case.split(':')[0])\n"
        "    except OSError as fault:\n"
        "        print('OSError', fault.errno)\n"
    )
    cases = [*(f"{format}:2000" for format in FORMATS), "hdf5:20000"]  # the last one fails when the file is closed
    done = subprocess.run(
        [sys.executable, "-c", script, str(log_path), str(log_path.with_name("out")), *cases],
        capture_output=True,
        text=True,
        check=False,
        cwd=Path(__file__).parents[3],
    )
    assert (done.returncode, done.stderr) == (0, "")  # HDF5 would crash on its own
    assert done.stdout.split("\n")[:-1] == [f"OSError {errno.EFBIG}"] * len(cases)
    assert set(log_path.parent.iterdir()) == before


def test_files_that_are_there_stay(log_path: Path) -> None:
    out = log_path.with_name("x.parquet")
    out.write_text("mine")
    with pytest.raises(ExchangeError, match="exists already"):
        export_log(log_path, out, channels=["laser/x"])
    assert out.read_text() == "mine"
    export_log(log_path, out, channels=["laser/x"], force=True)
    assert pq.read_table(out).num_rows == 1000


def test_a_table_too_large_for_mat_is_refused_with_another_format(
    log_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mat_file, "_LARGEST_VARIABLE", 10_000)
    with pytest.raises(ExchangeError, match=r"laser/x: expected less than 2 GB.*hdf5"):
        export_log(log_path, log_path.with_name("out.mat"))
    assert not log_path.with_name("out.mat").exists()


@pytest.mark.parametrize("format", ["parquet", "hdf5"])
def test_missing_parts_of_a_damaged_log_are_stated(log_path: Path, format: Any) -> None:
    data = bytearray(log_path.read_bytes())
    data[len(data) // 3] ^= 0xFF
    log_path.write_bytes(data)
    done = export_log(log_path, log_path.with_name("out"), format=format)
    assert done.missing
    assert 0 < done.rows["laser/x"] < 1000
    if format == "parquet":
        facts = json.loads(pq.read_schema(done.files[0]).metadata[b"provenance"])
        assert facts["missing"] == done.missing
        assert facts["complete"] is False


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"out": "out.xlsx"}, "expected a name ending in .parquet"),
        ({"channels": ["laser/z"]}, "did you mean"),
        ({"signals": True, "channels": ["z"]}, "expected signals of x, y, angles, marks"),
        ({"span_s": (2.0, 1.0)}, "expected the beginning before the end"),
        ({"span_s": (float("nan"), None)}, "seconds since the log's start"),
        ({"format": "xlsx"}, "expected a format of parquet, csv, mat, hdf5"),
    ],
)
def test_bad_use_is_explained(tmp_path: Path, options: dict[str, Any], words: str) -> None:
    path = write_small_log(tmp_path / "small.mcap")
    out = tmp_path / options.pop("out", "out.h5")
    with pytest.raises(Exception, match=words):
        export_log(path, out, **options)
    assert [file.name for file in tmp_path.iterdir()] == ["small.mcap"]
