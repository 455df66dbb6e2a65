"""`rig calibrate` on the virtual rig: what it writes, what it leaves, and what it refuses."""

from __future__ import annotations

import json
import shutil
from importlib import resources
from pathlib import Path

import pytest

from daq.log import open_log
from rig_cli.calibrated_rig_file import write_settings
from rig_cli.main import run
from rig_configs import RigFileError, load_rig
from rig_configs.device import DisplacementSettings

BLOCKS = ["--block", "-4, -2, 0, 2, 4 mm ± 1 µm", "--seconds", "0.3", "--rehearse", "--json"]


@pytest.fixture
def rig_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    path = tmp_path / "my.toml"
    shutil.copy(str(resources.files("rig_configs") / "one_laser.toml"), path)
    monkeypatch.chdir(tmp_path)
    return path


def test_the_result_is_written_with_a_record_of_the_old_values(
    rig_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = rig_file.read_text(encoding="utf-8")
    assert run(["calibrate", "my.toml", "probe", *BLOCKS, "--zero-at", "0 mm ± 1 µm", "--write"]) == 0
    shown = json.loads(capsys.readouterr().out)
    sensor = load_rig(rig_file).devices["probe"]
    assert isinstance(sensor, DisplacementSettings)
    assert (sensor.gain_factor, sensor.gain_std) == (shown["values"]["gain_factor"], shown["values"]["gain_std"])
    assert sensor.gain_factor != 1.0
    assert sensor.calibration_record.startswith(Path(shown["record"]).name)
    record = json.loads(Path(shown["record"]).read_text(encoding="utf-8"))
    assert record["before"]["gain_std"] == 0.001
    assert record["before"]["gain_factor"] is None
    assert record["calibrated"] == sensor.calibrated
    after = rig_file.read_text(encoding="utf-8").splitlines()
    assert [line for line in before.splitlines() if line not in after and not line.startswith("gain_std")] == []
    assert any(line.startswith("gain_std") and line.endswith("lever") for line in after)  # with its comment
    assert Path("out/01-calibrate-probe.svg").read_text(encoding="utf-8").count("<svg") == 1
    with open_log("out/01-calibrate-probe.mcap") as log:
        assert log.metadata["run"]["test"] == "calibrate"
    assert [path.name for path in Path().iterdir() if path.name.startswith(".")] == []


def test_without_consent_or_with_a_wrong_sign_the_file_stays(
    rig_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = rig_file.read_bytes()
    assert run(["calibrate", "my.toml", "probe", *BLOCKS]) == 0
    assert run(["calibrate", "my.toml", "probe", *BLOCKS, "--toward", "--write"]) == 1
    assert "refused: the reading falls" in capsys.readouterr().err
    assert rig_file.read_bytes() == before
    assert list(Path().glob("calibration-*")) == []


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["probe"], "expected at least two positions, better five"),
        (["probe", "--block", "2 mm"], "expected the standard uncertainty after the size"),
        (["lamp", "--block", "2, 4 mm ± 1 µm"], "no device 'lamp'; this rig has probe"),
    ],
)
def test_wrong_words_are_refused_before_a_device_is_opened(
    words: list[str], expected: str, rig_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["calibrate", "my.toml", *words, "--rehearse"]) == 2
    assert expected in capsys.readouterr().err
    assert not Path("out").exists()


def test_a_file_that_was_changed_meanwhile_or_would_be_invalid_is_left(rig_file: Path) -> None:
    text = rig_file.read_text(encoding="utf-8")
    with pytest.raises(RigFileError, match="was changed during the calibration"):
        write_settings(rig_file, "probe", {"gain_factor": 1.01}, text + "# edited\n")
    with pytest.raises(RigFileError, match="gain_factor"):
        write_settings(rig_file, "probe", {"gain_factor": 7.0}, text)
    assert rig_file.read_text(encoding="utf-8") == text
