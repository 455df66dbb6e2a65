"""Recordings of other programs: the log has the contents of the file, and implausible options are rejected."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings, strategies as st
from scipy.io import savemat

from daq.errors import LogError
from daq.exchange import ExchangeError, export_log, import_recording, make_recipe
from daq.exchange.recordings import open_recording
from daq.exchange.rotor_phase import revolutions_of_marks
from daq.log import open_log
from daq.log.losses import losses_of
from daq.signals.run import Run, load_run
from rig_configs import load_rig
from tests.daq.small_log import write_small_log
from tests.effort import cases

RIG = load_rig("virtual")
T = np.arange(200) / 1000
X_MM = 2 * np.exp(-T) * np.cos(50 * T)
EPOCH_2026_NS = 1_772_359_200_000_000_000


def bring_in(path: Path, **options: Any) -> Run:
    options = {"test": "ring-down-x", "start": "2026-03-01T10:00:00"} | options
    out = path.with_name("log.mcap")
    out.unlink(missing_ok=True)
    import_recording(path, out, RIG, make_recipe(**options))
    return load_run(out)


def text(path: Path, content: str, encoding: str = "utf-8") -> Path:
    path.write_bytes(content.encode(encoding))
    return path


def rows(delimiter: str, decimal: str = ".", end: str = "\n", tail: str = "") -> str:
    lines = (
        f"{a!r}{delimiter}{b!r}{tail}".replace(".", decimal) for a, b in zip(T.tolist(), X_MM.tolist(), strict=True)
    )
    return end.join(lines) + end


NAMES = {"time": "t:s", "x": "d:mm"}
NUMBERS = {"time": "1:s", "x": "2:mm"}


@pytest.mark.parametrize(
    ("content", "encoding", "columns"),
    [
        ("t,d\n" + rows(","), "utf-8", NAMES),
        ("t;d\n" + rows(";", ","), "utf-8-sig", NAMES),
        ("t\td\r\n" + rows("\t", ",", "\r\n"), "utf-16", NAMES),
        (rows(","), "utf-8", NUMBERS),
        (rows("   "), "utf-8", NUMBERS),
        (rows(" ", ","), "utf-8", NUMBERS),
        ("Prüfstand µ\nRate: 1000\n\nt;d\ns;mm\n" + rows(";", ","), "latin-1", NAMES),
        ("# t, d\n" + rows(", "), "utf-8", NAMES),
        ("% made by hand\n" + rows(","), "utf-8", NUMBERS),
        ('"t","d"\n' + rows(","), "utf-8", NAMES),
        ("t,d,\n" + rows(",", tail=","), "utf-8", NAMES),
        ("t,d\n" + rows(",", end="\n\n") + "# end\n", "utf-8", NAMES),
        ("t,d,state\n" + rows(",", tail=",ok"), "utf-8", NAMES),
        ("t|d\n[s]|[mm]\n" + rows("|"), "utf-8", NAMES),
        ("d,t,d\n" + rows(",").replace("\n", ",7\n"), "utf-8", {"time": "1:s", "x": "2:mm"}),
    ],
)
def test_texts_of_many_programs(tmp_path: Path, content: str, encoding: str, columns: dict[str, str]) -> None:
    run = bring_in(text(tmp_path / "a.csv", content, encoding), **columns)
    assert np.array_equal(run.x_m, X_MM * 1e-3)
    assert np.allclose(run.x_time_s, T, atol=1e-9, rtol=0)
    assert run.start_s == EPOCH_2026_NS / 1e9


@pytest.mark.parametrize(
    ("column", "factor"),
    [("d:mm", 1e-3), ("d:-mm", -1e-3), ("d:um", 1e-6), ("d:0.0015", 1.5e-3), ("d:in", 0.0254), ("2:mm", 1e-3)],
)
def test_units_signs_and_scales(tmp_path: Path, column: str, factor: float) -> None:
    lines = "".join(f"{a!r},{b!r}\n" for a, b in zip(T.tolist(), (X_MM / 4).tolist(), strict=True))
    run = bring_in(text(tmp_path / "a.csv", "t,d\n" + lines), time="t:s", x=column)
    assert np.array_equal(run.x_m, X_MM / 4 * factor)


@pytest.mark.parametrize(
    ("content", "options", "words"),
    [
        (rows(","), {"x": "2:furlong"}, "expected a unit of length .*got 'furlong'"),
        (rows(","), {"x": "2:s"}, "which is a unit of time"),
        (rows(","), {"x": "2"}, "expected NAME:UNIT"),
        (rows(","), {"x": "2:0"}, "number other than 0"),
        (
            "t,disp\n" + rows(","),
            {"x": "dsip:mm", "time": "t:s"},
            "x: expected one of the columns 't', 'disp', got 'dsip'; did",
        ),
        (
            rows(","),
            {"time": "1:s", "x": "2:m"},
            r"expected readings within 0.025 m, got 2 .*line 1.*did you mean 2:mm\?",
        ),
        (rows(",").replace("0.1,", "0.1,oops", 1), NUMBERS, "line 101: expected a number in column '2'.*'oops"),
        (rows(",") + "0.2\n", NUMBERS, "line 201: expected 2 columns as in line 1, got 1; is the file cut"),
        (
            rows(",") + "0.1,1.0\n",
            NUMBERS,
            r"line 201: expected a time after 0.199 s, got an earlier time \(0.1\); 1 row of 201",
        ),
        (rows(",") + "0.199,1.0\n", NUMBERS, "the same time again"),
        (rows(",").replace("0.1,", ",", 1), NUMBERS, "line 101: expected a time, got none; 1 of 200"),
        (rows(",").replace("0.1,", "nan,", 1), NUMBERS, "line 101: expected a time, got none"),
        (rows(",").replace("0.1,", "1_0,", 1), NUMBERS, "got '1_0'"),
        ("t,x\n0,1\n1,2\n", NAMES | {"x": "x:mm"}, "expected at least 20 samples, got 2"),
        ("hello\nworld\n", NUMBERS, "expected columns of numbers, found none"),
        ("", NUMBERS, "the file is empty"),
        ("a\0b", NUMBERS, "expected text, parquet, mat or hdf5"),
        (rows(","), {"x": "2:mm"}, "expected a column of times or a rate in addition"),
        (rows(","), {"x": "2:mm", "time": "1:s", "rate_Hz": 10}, "got both"),
        (rows(","), {"time": "1:s"}, "at least one of x, y"),
        (rows(","), {**NUMBERS, "test": ""}, "expected the test's name"),
        (rows(","), {**NUMBERS, "start": "yesterday"}, "start yesterday: expected a time like"),
        (
            rows(","),
            {**NUMBERS, "release_s": (7.0,)},
            "release 7: expected a time within the recording, 0 s to 0.199 s",
        ),
        (rows(","), {**NUMBERS, "phase": "1:rad", "speed": "2:rpm"}, "one of phase, marks and speed"),
        (rows(","), {**NUMBERS, "nonsense": 1}, "nonsense"),
        (
            "".join(f"{i},{7 * i}\n" for i in range(50)),
            {"time": "1:ms", "x": "2:um"},
            "decimal comma or a second column",
        ),
        ("".join(f"{i}^{i},{i}5\n" for i in range(50)), {"rate_Hz": 100, "x": "2:um"}, "found none"),
        (
            "".join(f"{i} {i},5 7,5\n" for i in range(50)),
            {"rate_Hz": 100, "x": "3:mm", "y": "4:mm"},
            "'1', '2', '3', got '4'",
        ),
    ],
)
def test_what_cannot_be_meant_is_refused(tmp_path: Path, content: str, options: dict[str, Any], words: str) -> None:
    path = text(tmp_path / "a.csv", content)
    with pytest.raises(ExchangeError, match=words):
        bring_in(path, **options)
    assert [file.name for file in tmp_path.iterdir()] == ["a.csv"]


def test_a_log_is_never_written_over(tmp_path: Path) -> None:
    path, out = text(tmp_path / "a.csv", rows(",")), tmp_path / "log.mcap"
    recipe = make_recipe(test="ring-down-x", **NUMBERS)
    import_recording(path, out, RIG, recipe)
    before = out.read_bytes()
    with pytest.raises(LogError, match="exists already"):
        import_recording(path, out, RIG, recipe)
    assert out.read_bytes() == before


def test_what_is_interrupted_leaves_no_log(tmp_path: Path) -> None:
    path = text(tmp_path / "a.csv", rows(","))

    def stop(share: float) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        import_recording(path, tmp_path / "log.mcap", RIG, make_recipe(test="t", **NUMBERS), stop)
    assert [file.name for file in tmp_path.iterdir()] == ["a.csv"]


@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
def test_whole_numbers_of_time_are_exact(tmp_path: Path, unit: str) -> None:
    per_second = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}[unit]
    times = [1_700_000_000 * per_second + i * max(1, per_second // 1000) for i in range(30)]
    path = text(tmp_path / "a.csv", "".join(f"{t},{i * 0.1}\n" for i, t in enumerate(times)))
    import_recording(path, tmp_path / "log.mcap", RIG, make_recipe(test="t", time=f"1:{unit}", x="2:mm"))
    with open_log(tmp_path / "log.mcap") as log:
        assert log["laser/x"].time_ns.tolist() == [t * (10**9 // per_second) for t in times]
        assert log["laser/x"].log_time_ns.tolist() == log["laser/x"].time_ns.tolist()


def test_gaps_are_counted_invalid_readings_stay_none_and_empty_cells_are_no_samples(tmp_path: Path) -> None:
    lines = []
    for i, (t, x) in enumerate(zip(T.tolist(), X_MM.tolist(), strict=True)):
        if 50 <= i < 53 or i == 120:
            continue
        cell = "-9999" if i in (10, 11) else "NaN" if i == 12 else repr(x)
        lines.append(f"{t!r},{cell},{repr(x) if i % 4 == 0 else ''}\n")
    path, out = text(tmp_path / "a.csv", "t,x,y\n" + "".join(lines)), tmp_path / "log.mcap"
    done = import_recording(
        path, out, RIG, make_recipe(test="ring-down-x", time="t:s", x="x:mm", y="y:mm", invalid=(-9999.0,))
    )
    run = load_run(out)
    assert np.flatnonzero(np.isnan(run.x_m)).tolist() == [10, 11, 12]
    assert done.samples == {"laser/x": 196, "laser/y": 48}
    assert done.invalid == {"laser_x": 3, "laser_y": 0}
    assert done.gaps == {"laser_x": 4, "laser_y": 2}
    assert run.losses == {"laser_x.samples": 4, "laser_x.invalid": 3, "laser_y.samples": 2, "laser_y.invalid": 0}
    with open_log(out) as log:
        gaps = [(e["device"], e["samples"], round(e["span_s"], 6)) for e in log.events]
        assert gaps == [("laser_y", 1, 0.008), ("laser_x", 3, 0.004), ("laser_y", 1, 0.008), ("laser_x", 1, 0.002)]
        assert losses_of(log).total == 6


def test_the_log_contains_its_origin(tmp_path: Path) -> None:
    path = text(tmp_path / "a.csv", "t,d\n" + rows(","))
    run = bring_in(path, **NAMES, point="A", test="", note="µ", release_s=(0.1,), counts_per_revolution=1000)
    with open_log(tmp_path / "log.mcap") as log:
        facts, made = log.metadata["run"], json.loads(log.attachments["import.json"])
        assert log.complete
    assert (facts["test"], facts["point"], facts["note"], facts["rig"]) == ("point-A", "A", "µ", "virtual")
    assert facts["started"] == "2026-03-01T10:00:00+00:00"
    assert facts["origin"] == f"a.csv sha256:{made['files'][0]['sha256']}"
    assert made["options"]["x"] == "d:mm"
    assert [(r.pendulum, round(r.time_s, 9)) for r in run.releases] == [(0, 0.1), (1, 0.1)]
    assert run.angle_step_rad == 2 * np.pi / 1000
    assert list(run.clock_rate_std.values()) == pytest.approx([30e-6] * 4)  # from the rig file
    assert set(run.clocks.values()) == {"recorder"}
    assert facts["clock_tolerance_from"] == "rig file"
    assert any("missing: laser/y, pendulums, tacho" in warning for warning in made["warnings"])


def test_matlab_structs_matrices_and_times_of_their_own(tmp_path: Path) -> None:
    slow = T[::5]
    theta = np.column_stack([90 * slow, 180 + 0 * slow])
    values = {"run": {"t": T, "x": X_MM, "label": "hello"}, "enc": {"t": slow * 1e3, "theta": theta}}
    savemat(tmp_path / "five.mat", values)
    with h5py.File(tmp_path / "seven.mat", "w", userblock_size=512) as file:
        for name, data in {
            "run/t": T[None],
            "run/x": X_MM[None],
            "enc/t": slow[None] * 1e3,
            "enc/theta": theta.T,
        }.items():
            file[name] = data
    columns = {
        "time": "run.t:s",
        "x": "run.x:mm",
        "theta3": "enc.theta.1:deg@enc.t:ms",
        "theta4": "enc.theta.2:deg@enc.t:ms",
    }
    for name in ("five.mat", "seven.mat"):
        run = bring_in(tmp_path / name, **columns)
        assert np.array_equal(run.x_m, X_MM * 1e-3)
        assert np.allclose(run.angle_rad, np.radians(theta), rtol=1e-15)
        assert np.allclose(run.angle_time_s, slow, atol=1e-9)
        with pytest.raises(ExchangeError, match=r"expected one of the columns.*'run.x'.*did you mean 'run.x'"):
            bring_in(tmp_path / name, **columns | {"x": "runx:mm"})
        with pytest.raises(ExchangeError, match=r"as many values as there are times, got 40 and 200.*@TIME"):
            bring_in(tmp_path / name, **columns | {"theta3": "enc.theta.1:deg"})


def test_wrapped_angles_are_unwrapped_over_missing_readings(tmp_path: Path) -> None:
    angle = np.linspace(-100, 1000, 200)
    table = np.column_stack([T, (angle + 180) % 360 - 180, np.full(200, 180.0)])
    table[100, 1] = np.nan
    np.savetxt(tmp_path / "a.csv", table, "%.17g", delimiter=",")
    run = bring_in(tmp_path / "a.csv", time="1:s", theta3="2:deg", theta4="3:deg")
    assert np.allclose(run.angle_rad[:, 0], np.radians(np.delete(angle, 100)))
    assert np.allclose(run.angle_rad[:, 1], np.pi)


def test_parquet_nulls_are_no_samples(tmp_path: Path) -> None:
    table = pa.table(
        {"t": pa.array(range(100)), "x": [None if i % 2 else i * 0.01 for i in range(100)], "s": ["a"] * 100}
    )
    pq.write_table(table, tmp_path / "a.parquet")
    run = bring_in(tmp_path / "a.parquet", time="t:ms", x="x:mm")
    assert np.allclose(run.x_time_s, np.arange(0, 100, 2) * 1e-3)
    with pytest.raises(ExchangeError, match="expected numbers in column 's', got string"):
        bring_in(tmp_path / "a.parquet", time="t:ms", x="s:mm")


@pytest.mark.parametrize("format", ["csv", "parquet", "mat", "h5"])
def test_what_we_export_comes_back_exactly(tmp_path: Path, format: str) -> None:
    source = write_small_log(tmp_path / "source.mcap")
    done = export_log(source, tmp_path / f"out.{format}", channels=["laser/x"])
    name = {"mat": "laser_x.", "h5": "laser.x."}.get(format, "")
    back = tmp_path / "back.mcap"
    import_recording(
        done.files[0], back, RIG, make_recipe(test="small", time=f"{name}time_ns", x=f"{name}displacement_m")
    )
    with open_log(source) as a, open_log(back) as b:
        assert np.array_equal(a["laser/x"].time_ns, b["laser/x"].time_ns)
        assert np.array_equal(a["laser/x"].displacement_m, b["laser/x"].displacement_m)


def phase_file(path: Path, phase: np.ndarray) -> Path:
    return text(
        path,
        "".join(f"{t!r},{p!r}\n" for t, p in zip((np.arange(len(phase)) / 1000).tolist(), phase.tolist(), strict=True)),
    )


def test_the_rotor_by_its_angle_its_marks_or_its_speed(tmp_path: Path) -> None:
    t = np.arange(3000) / 1000
    psi = 1.0 + 20 * t + 5 * t**2
    turns = 2 * np.pi * np.arange(1, 17)
    times = (-20 + np.sqrt(400 + 20 * (turns - 1))) / 10
    wrapped = phase_file(tmp_path / "wrapped.csv", np.angle(np.exp(1j * psi)))
    for run in (
        bring_in(wrapped, time="1:s", phase="2:rad"),
        bring_in(phase_file(tmp_path / "whole.csv", np.degrees(psi)), time="1:s", phase="2:deg"),
    ):
        assert np.allclose(run.mark_phase_rad[:16], turns)
        assert np.allclose(run.mark_time_s[:16], times, atol=1e-6)
        assert run.phase_absolute
    marks = text(tmp_path / "marks.csv", "".join(f"{m!r}\n" for m in np.delete(times, 7).tolist()))
    run = bring_in(wrapped, time="1:s", phase=None, theta3="2:rad", marks=f"{marks}:s")
    assert np.allclose(run.mark_time_s, np.delete(times, 7), atol=1e-9)
    assert np.allclose(run.mark_phase_rad, np.delete(2 * np.pi * np.arange(16), 7))
    assert run.phase_absolute
    speed = phase_file(tmp_path / "speed.csv", (20 + 10 * t) * 30 / np.pi)
    run = bring_in(speed, time="1:s", speed="2:rpm")
    assert np.allclose(run.mark_time_s[1:16], (-20 + np.sqrt(400 + 20 * turns[:15])) / 10, atol=1e-6)
    assert run.metadata["phase_reference"] == "none"
    assert not run.phase_absolute


def test_a_phase_that_falls_is_refused(tmp_path: Path) -> None:
    path = phase_file(tmp_path / "a.csv", -20 * np.arange(3000) / 1000)
    with pytest.raises(ExchangeError, match=r"falls from -?0 to -59.98 rad.*minus sign: NAME:-rad"):
        bring_in(path, time="1:s", phase="2:rad")
    assert len(bring_in(path, time="1:s", phase="2:-rad").mark_time_s) == 10


@given(lost=st.sets(st.integers(4, 56), max_size=8), acceleration=st.floats(0.5, 30))
def test_missing_marks_are_counted_from_rest_on(lost: set[int], acceleration: float) -> None:
    lost = {i for i in lost if not {i - 1, i + 1, i + 2, i - 2} & lost}
    every = np.arange(1, 60)
    times = np.sqrt(2 * 2 * np.pi * every / acceleration)
    keep = np.array([i not in lost for i in every])
    found, warnings = revolutions_of_marks((times[keep] * 1e9).astype(np.int64))
    assert np.array_equal(found, (every - 1)[keep])
    assert bool(warnings) == bool(lost)


@settings(max_examples=cases(20, 40), deadline=None)
@given(
    values=st.lists(st.floats(-0.01, 0.01, allow_subnormal=True), min_size=20, max_size=60),
    delimiter=st.sampled_from([",", ";", "\t", " ", "|"]),
    comma=st.booleans(),
)
def test_every_number_survives_every_dialect(
    tmp_path_factory: pytest.TempPathFactory, values: list[float], delimiter: str, comma: bool
) -> None:
    comma = comma and delimiter != ","
    path = tmp_path_factory.mktemp("dialect") / "a.csv"
    lines = "".join(f"{i}{delimiter}{v!r}\n" for i, v in enumerate(values))
    text(path, lines.replace(".", ",") if comma else lines)
    column = open_recording(path).read(["2"])["2"]
    assert column.values.tolist() == values


@pytest.mark.parametrize("suffix", ["csv", "parquet", "mat", "h5"])
def test_damaged_files_are_refused_in_words(tmp_path: Path, suffix: str) -> None:
    source = write_small_log(tmp_path / "small.mcap")
    whole = export_log(source, tmp_path / f"whole.{suffix}", channels=["laser/x"]).files[0].read_bytes()
    rng = np.random.default_rng(0)
    name = {"mat": "laser_x.", "h5": "laser.x."}.get(suffix, "")
    recipe = make_recipe(test="t", time=f"{name}time_ns", x=f"{name}displacement_m")
    refused = 0
    for attempt in range(40):
        data = bytearray(whole)
        if attempt % 2:
            del data[int(rng.integers(1, len(data))) :]
        else:
            for at in rng.integers(0, len(data), 4):
                data[at] ^= 1 << int(rng.integers(8))
        path = tmp_path / f"damaged.{suffix}"
        path.write_bytes(data)
        (tmp_path / "log.mcap").unlink(missing_ok=True)
        with contextlib.suppress(ExchangeError):  # anything else fails the test
            import_recording(path, tmp_path / "log.mcap", RIG, recipe)
            continue
        refused += 1
        assert not (tmp_path / "log.mcap").exists()
    assert refused >= (10 if suffix == "csv" else 15)
