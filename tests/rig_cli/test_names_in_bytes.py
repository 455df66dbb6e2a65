"""Names and notes with bytes that are not UTF-8, as old file systems, shells and devices contain them."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from daq.acquisition.effects import Note
from daq.acquisition.recorder import Recorder
from daq.items import DeviceEvent
from daq.log import open_log
from daq.transports import HostClock
from live import frames
from rig_basics.texts import storable
from rig_cli import main
from rig_configs import IdentifiedParameters, load_rig
from tests.daq.small_log import write_small_log

LATIN = os.fsdecode(b"\xe9")
"""The letter é of an old file system, which is not UTF-8."""

pytestmark = pytest.mark.skipif(
    os.fsencode(LATIN) != b"\xe9" or sys.platform in ("win32", "darwin"), reason="file names are UTF-8 here"
)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    place = tmp_path / f"caf{LATIN}"
    place.mkdir()
    return place


@pytest.fixture
def log(folder: Path) -> Path:
    return write_small_log(folder / f"l{LATIN}.mcap")


@pytest.mark.parametrize("text", ["note \udcff", "\ud83d", "a\ud800\udc00b"])
def test_no_text_that_cannot_be_stored_ends_a_recording(text: str, tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run.mcap", HostClock(), {"test": "record", "note": text}, {}, ())
    recorder.add(Note(DeviceEvent("note", "host", text, {"time_ns": 1}), 1))
    with open_log(recorder.close({"ended": text})) as opened:
        (event,) = opened.events
        found = [opened.metadata["run"]["note"], event["text"], json.loads(opened.metadata["summary"]["ended"])]
    for each in found:
        assert each.encode()  # UTF-8
        assert "\ufffd" in each
    assert frames.encode({"note": text}, {})


def test_text_that_can_be_stored_stays_as_it_is() -> None:
    assert storable("µm 😀 \n") == "µm 😀 \n"


@pytest.mark.parametrize("suffix", ["parquet", "csv", "mat", "h5"])
def test_a_log_is_exported_to_and_from_such_names(suffix: str, folder: Path, log: Path) -> None:
    assert main.run(["export", str(log), "-o", str(folder / f"out{LATIN}.{suffix}"), "--json"]) == 0
    assert [path for path in folder.iterdir() if path.name.startswith("out") and path.suffix == f".{suffix}"]


def test_a_cut_log_is_recovered(folder: Path, log: Path) -> None:
    part = folder / f"cut{LATIN}.mcap.part"
    part.write_bytes(log.read_bytes()[:-3000])
    assert main.run(["recover", str(part), "-o", str(folder / f"whole{LATIN}.mcap")]) == 0
    assert main.run(["log", str(folder / f"whole{LATIN}.mcap")]) == 0


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_a_recording_made_elsewhere_is_imported(suffix: str, folder: Path) -> None:
    file, columns = folder / f"decay{LATIN}.{suffix}", {"t": 0.002 * np.arange(500), "x": np.arange(500.0) % 7}
    with file.open("wb") as opened:
        if suffix == "csv":
            np.savetxt(opened, np.column_stack(list(columns.values())), delimiter=",", header="t,x", comments="")
        else:
            parquet.write_table(pa.table(columns), opened)
    log = folder / f"decay{LATIN}.mcap"
    arguments = ["import", str(file), "--time", "t:s", "--x", "x:mm", "--test", "ring-down-x", "--rig", "virtual"]
    assert main.run([*arguments, "-o", str(log)]) == 0
    assert main.run(["log", str(log)]) == 0


def test_parameters_name_the_logs_they_came_from(folder: Path) -> None:
    file = folder / f"parameters{LATIN}.toml"
    IdentifiedParameters({"k1_N_per_m": 1.0}, np.eye(1), {"logs": [f"l{LATIN}.mcap"]}).save(file)
    assert load_rig("virtual", file).name == load_rig("virtual").name
