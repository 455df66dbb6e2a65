"""Recordings whose numbers could be read in two ways, are cut, or take long: a right answer, or a refusal in time."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from daq.errors import LogError
from daq.exchange import ExchangeError, import_recording, make_recipe
from daq.exchange.imported_log import DISPLACEMENT_X, Part, write_log
from daq.exchange.recordings import open_recording
from daq.log.time_span import TimeSpan
from daq.signals.run import Run, load_run
from rig_configs import load_rig

RIG = load_rig("virtual")
N = 60
UM = np.rint(3000 * np.exp(-np.arange(N) / 40) * np.cos(np.arange(N) / 20)).astype(int)
_COLUMNS = {"time": "n:0.002", "x": "x:um"}


def bring_in(path: Path, content: str, **options: Any) -> tuple[Run, list[str]]:
    path.write_bytes(content.encode())
    out = path.with_name("log.mcap")
    out.unlink(missing_ok=True)
    done = import_recording(path, out, RIG, make_recipe(test="ring-down-x", **(_COLUMNS | options)))
    return load_run(out), done.warnings


def grouped(value: int, sign: str) -> str:
    return f"{value:,}".replace(",", sign)


def table(delimiter: str, sign: str, values: np.ndarray = UM, times: str = "{}") -> str:
    rows = (f"{times.format(i)}{delimiter}{grouped(int(v), sign)}\n" for i, v in enumerate(values))
    return f"n{delimiter}x\n" + "".join(rows)


@pytest.mark.parametrize("delimiter", ["\t", ";", "|"])
@pytest.mark.parametrize("sign", [",", "."])
@pytest.mark.parametrize("first", [UM, np.concatenate([np.full(500, 12), UM])], ids=["at once", "late"])
def test_separators_of_thousands_are_no_decimal_signs(
    tmp_path: Path, delimiter: str, sign: str, first: np.ndarray
) -> None:
    content = table(delimiter, sign, first)
    with pytest.raises(ExchangeError, match=r"decimal sign|decimal point, got"):
        bring_in(tmp_path / "a.txt", content)
    run, _ = bring_in(tmp_path / "a.txt", content, decimal={",": ".", ".": ","}[sign])
    assert np.allclose(run.x_m, first * 1e-6, atol=0, rtol=1e-12)


def test_thousands_and_decimals_in_one_number(tmp_path: Path) -> None:
    rows = "".join(f"{i};{grouped(int(v), '.')},5\n" for i, v in enumerate(UM))
    run, _ = bring_in(tmp_path / "a.txt", "n;x\n" + rows, decimal=",")
    assert np.allclose(run.x_m, (np.where(UM < 0, -1, 1) * 0.5 + UM) * 1e-6, atol=1e-15)


@pytest.mark.parametrize("sign", [",", "."])
@pytest.mark.parametrize("times", ["{}", "0{sign}{{:04d}}"])
def test_three_decimals_are_decimals_where_a_number_shows_it(tmp_path: Path, sign: str, times: str) -> None:
    rows = "".join(f"{i};{v / 1000:.3f}\n".replace(".", sign) for i, v in enumerate(UM))  # 2,995 and 0,985
    run, _ = bring_in(tmp_path / "a.txt", "n;x\n" + rows, x="x:mm")
    assert np.allclose(run.x_m, UM * 1e-6, atol=1e-15)


def test_a_point_with_three_decimals_throughout_is_a_point(tmp_path: Path) -> None:
    rows = "".join(f"{i}\t{10 + v / 1000:.3f}\n" for i, v in enumerate(UM))
    run, _ = bring_in(tmp_path / "a.txt", "n\tx\n" + rows, x="x:mm")
    assert np.allclose(run.x_m, 0.01 + UM * 1e-6, atol=1e-15)


@pytest.mark.parametrize("cut", [1, 2, 3, 5, 8, 9])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_a_last_line_that_was_cut_is_left_out_and_reported(tmp_path: Path, cut: int, end: str) -> None:
    content = "n,x\n" + "".join(f"{i},{v}.25{end}" for i, v in enumerate(UM))
    last = f"{N - 1},{UM[-1]}.25{end}"
    run, warnings = bring_in(tmp_path / "a.csv", content[: len(content) - min(cut + len(end) - 1, len(last) - 1)])
    assert len(run.x_m) == N - 1
    assert run.x_m[-1] == pytest.approx((UM[-2] + np.sign(UM[-2]) * 0.25) * 1e-6, abs=1e-12)
    assert [w for w in warnings if f"line {N + 1}, the last one, has no line end" in w]
    run, warnings = bring_in(tmp_path / "a.csv", content)
    assert len(run.x_m) == N
    assert not [w for w in warnings if "line end" in w]


def test_a_part_of_a_recording_is_imported(tmp_path: Path) -> None:
    content = "n,x\n" + "".join(f"{i},{v}\n" for i, v in enumerate(UM))
    run, _ = bring_in(tmp_path / "a.csv", content, from_s=0.02, to_s=0.1)
    assert np.allclose(run.x_m, UM[10:50] * 1e-6)
    epoch = "n,x\n" + "".join(f"{1_772_359_200 + i / 500:.3f},{v}\n" for i, v in enumerate(UM))
    run, _ = bring_in(tmp_path / "a.csv", epoch, time="n:s", from_s=0.02)
    assert np.allclose(run.x_m, UM[10:] * 1e-6)
    with pytest.raises(ExchangeError, match=r"from 0\.1 s to the end, got 10; the recording"):
        bring_in(tmp_path / "a.csv", content, from_s=0.1)
    with pytest.raises(LogError, match="expected the beginning before the end"):
        bring_in(tmp_path / "a.csv", content, from_s=2, to_s=1)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"time": None, "rate_Hz": 1e-300}, "rate 1e-300: expected samples per second"),
        ({"time": None, "rate_Hz": 1e-9}, "would take more than 146 years"),
        ({"start": "2300-01-01"}, "expected a time from 1970 to 2116"),
        ({"start": "9999-12-31T23:59:59-23:59"}, "expected a time from 1970 to 2116"),
        ({"from_s": 1e300}, "below 146 years"),
        ({"release_s": (1e300,)}, "release"),
    ],
)
def test_impossible_times_are_refused(tmp_path: Path, options: dict[str, Any], words: str) -> None:
    content = "n,x\n" + "".join(f"{i},{v}\n" for i, v in enumerate(UM))
    with pytest.raises(LogError, match=words):
        bring_in(tmp_path / "a.csv", content, **options)


def foreign_log(path: Path, metres: np.ndarray) -> Path:
    times = 1_772_359_200_000_000_000 + np.arange(len(metres)) * 2_000_000
    part = Part(DISPLACEMENT_X, times, {"displacement_m": metres})
    attachments = {"rig.json": RIG.snapshot_json(), "roles.json": RIG.roles_json(), "identities.json": b"{}"}
    return write_log(path, [part], [], {"test": "ring-down-x"}, attachments, {}, lambda _: None)


@pytest.mark.parametrize(("factor", "unit"), [(1e6, "µm"), (1e3, "mm")])
def test_displacements_in_another_unit_are_refused_with_the_likely_unit(
    tmp_path: Path, factor: float, unit: str
) -> None:
    metres = 3e-3 * np.exp(-np.arange(500) / 100) * np.cos(np.arange(500) / 7)
    assert len(load_run(foreign_log(tmp_path / "right.mcap", metres)).x_m) == 500
    with pytest.raises(LogError, match=f"displacement along x: .*laser_x.*the values look like {unit}"):
        load_run(foreign_log(tmp_path / "wrong.mcap", metres * factor))


def test_a_part_of_a_log_is_loaded(tmp_path: Path) -> None:
    metres = 3e-3 * np.cos(np.arange(500) / 7)
    log = foreign_log(tmp_path / "a.mcap", metres)
    part = load_run(log, TimeSpan(0.2, 0.5))
    assert np.allclose(part.x_m, metres[100:250], atol=1e-9)
    assert part.metadata["part"] == "0.2 s to 0.5 s"
    assert "part" not in load_run(log).metadata


def test_many_columns_are_read_in_time(tmp_path: Path) -> None:
    width = 100_000
    path = tmp_path / "wide.csv"
    with open(path, "w", encoding="utf-8") as file:
        file.write(",".join(f"c{i}" for i in range(width)) + "\n")
        for i in range(10):
            file.write(",".join([str(i), *["1"] * (width - 1)]) + "\n")
    started = time.process_time()
    recording = open_recording(path)
    recipe = make_recipe(test="t", time="cc:ms", x="c1:um")
    with pytest.raises(ExchangeError, match="expected one of the columns"):
        import_recording(path, tmp_path / "a.mcap", RIG, recipe)
    assert len(recording.names) == width
    assert recording.read(["c0"])["c0"].values.tolist() == list(range(10))
    assert time.process_time() - started < 15.0, "s of processor; minutes if each name is compared with every other"


@pytest.mark.parametrize(("groups", "levels"), [(10_000, 1), (1, 100)])
def test_too_many_groups_are_refused_in_time(tmp_path: Path, groups: int, levels: int) -> None:
    path = tmp_path / "many.h5"
    with h5py.File(path, "w", libver="latest") as file:
        file["x"] = np.arange(100.0)
        for i in range(groups):
            file.create_group("/".join([f"g{i}"] * levels))
    with pytest.raises(ExchangeError, match="got more than 10000 groups and datasets, or more than 64 levels"):
        open_recording(path)


def test_groups_that_contain_themselves_are_listed_once(tmp_path: Path) -> None:
    path = tmp_path / "loop.h5"
    with h5py.File(path, "w") as file:
        file["a/x"] = np.arange(100.0)
        file["a/again"] = file["a"]
        file["b"] = file["a/x"]
    names = open_recording(path).names
    assert {"a.x", "b"} <= set(names)
    assert len(names) == 3 - 1
