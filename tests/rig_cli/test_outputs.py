"""Files that commands write: an existing one is replaced on request only, and none is left half written."""

from __future__ import annotations

import signal
import sys
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from analysis.figures.page import write_figure
from analysis.figures.style import drawing
from daq.errors import RecordingError
from daq.log.verdicts import LoggedVerdict, keep_verdict
from rig_cli.calibrated_rig_file import write_settings
from rig_cli.main import run
from rig_configs import IdentifiedParameters
from rig_configs.load import rig_text
from tests.daq.small_log import write_small_log
from tests.rig_cli.test_validate import known

_WIDE = "speed_ratio=1:2:3"
_COMMANDS = {
    "identify -o": ["identify", "{log}", "-o", "{out}/a.toml"],
    "validate --report": ["validate", "virtual", "{log}", "--parameters", "{known}", "--report", "{out}/a.html"],
    "report -o": ["report", "{log}", "-o", "{out}/a.html"],
    "predict --plot": ["predict", "virtual", "--point", "B", "--plot", "{out}/a.svg"],
    "react --plot": ["react", "virtual", "--point", "B", "--change", "imbalance.radius_m=+1%", "--plot", "{out}/a.svg"],
    "basins -o": ["basins", "virtual", "--point", "B", "-o", "{out}/a.npz"],
    "basins --plot": ["basins", "virtual", "--point", "B", "--plot", "{out}/a.svg"],
    "map -o": ["map", "virtual", "--x", _WIDE, "--y", "stiffness_ratio=1:3:3", "-o", "{out}/a.npz"],
    "map --plot": ["map", "virtual", "--x", _WIDE, "--y", "stiffness_ratio=1:3:3", "--plot", "{out}/a.svg"],
    "log --plot": ["log", "{log}", "--plot", "{out}/a.svg"],
    "parameters history --plot": ["parameters", "history", "{known}", "--plot", "{out}/a.svg"],
    "plot -o": ["plot", "health", "{log}", "-o", "{out}/a.svg"],
    "track -o": ["track", "{log}", "-o", "{out}/a.csv"],
    "export -o": ["export", "{log}", "-o", "{out}/a.h5"],
    "virtual --output": ["virtual", "virtual", "--output", "{out}/a.toml"],
}


@pytest.mark.parametrize("words", _COMMANDS.values(), ids=_COMMANDS)
def test_an_existing_file_is_not_replaced_unasked(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, toml, out = write_small_log(tmp_path / "small.mcap"), known(tmp_path / "known.toml"), tmp_path / "out"
    out.mkdir()
    taken = out / Path(words[-1]).name
    taken.write_text("mine", encoding="utf-8")
    assert run([word.format(log=log, known=toml, out=out) for word in words]) == 2
    assert "exists" in capsys.readouterr().err
    assert taken.read_text(encoding="utf-8") == "mine"
    assert list(out.iterdir()) == [taken]


def test_an_existing_file_is_replaced_on_request(tmp_path: Path) -> None:
    taken = tmp_path / "a.svg"
    taken.write_text("mine", encoding="utf-8")
    log = write_small_log(tmp_path / "small.mcap")
    assert run(["log", str(log), "--plot", str(taken), "--force"]) == 0
    assert taken.read_text(encoding="utf-8").startswith("<?xml")


@contextmanager
def full_disk(limit: int = 64) -> Generator[None]:
    """A disk on which no file grows beyond some bytes."""
    import resource

    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)


def _parameters(path: Path) -> None:
    IdentifiedParameters({"zeta1": 0.02}, np.array([[1e-8]]), {"tests": []}).save(path)


def _figure(path: Path) -> None:
    with drawing(3, 3) as figure:
        figure.add_subplot().plot([0, 1], [0, 1])
        write_figure(path, figure, "a figure")


def _rig_file(path: Path) -> None:
    write_settings(path, "laser_x", {"gain_std": 0.002}, path.read_text(encoding="utf-8"))


@pytest.mark.skipif(sys.platform == "win32", reason="needs the limits of POSIX")
@pytest.mark.parametrize(
    ("name", "write"),
    [("a.toml", _parameters), ("a.svg", _figure), ("a.png", _figure), ("a.html", _figure), ("rig.toml", _rig_file)],
)
def test_a_full_disk_leaves_the_old_file_alone(tmp_path: Path, name: str, write: object) -> None:
    path, old = tmp_path / name, rig_text("virtual")[1]
    path.write_text(old, encoding="utf-8")
    assert callable(write)
    with full_disk(), pytest.raises(OSError, match="File too large"):
        write(path)
    assert path.read_text(encoding="utf-8") == old
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.skipif(sys.platform == "win32", reason="needs the limits of POSIX")
def test_a_full_disk_leaves_the_old_verdict_alone(tmp_path: Path) -> None:
    verdict = LoggedVerdict(verdict="pass", judged_at="2026-03-01T10:00:00+00:00", digest="sha256:" + 64 * "0")
    place = keep_verdict(tmp_path / "a.mcap", verdict)
    old = place.read_bytes()
    with full_disk(), pytest.raises(RecordingError, match="cannot be written"):
        keep_verdict(tmp_path / "a.mcap", verdict.model_copy(update={"verdict": "fail"}))
    assert place.read_bytes() == old
    assert list(tmp_path.iterdir()) == [place]
