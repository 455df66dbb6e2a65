"""`rig replay`: what it prints, what it exits with, and a whole recording played out and recorded again."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from pathlib import Path
from typing import IO

import numpy as np
import pytest
from cyclopts import App

from daq.errors import LogError
from daq.items import Batch, DeviceEvent
from daq.log import open_log
from daq.log.samples import Samples
from daq.replay import check
from daq.transports import open_link
from daq.version import DECODER
from rig_cli import replay_view
from rig_cli.replay import replay
from rig_configs.errors import RigFileError
from tests.daq.replayed_log import IDENTITIES, write_log


def run_rig(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    """Exit code, standard output and standard error of one `rig replay`."""
    app = App()
    app.default(replay)
    code = app(arguments, exit_on_error=False, result_action="return_value")
    captured = capsys.readouterr()
    return code, captured.out, captured.err


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return write_log(tmp_path / "a.mcap")


@pytest.fixture
def falsified(tmp_path: Path) -> Path:
    def falsify(number: int, item: Batch | DeviceEvent, host_ns: int) -> tuple[Batch | DeviceEvent, int]:
        if isinstance(item, Batch) and item.channel.topic == "motor" and number > 150:
            return Batch(
                item.channel,
                item.time_ns,
                item.sequence,
                {**item.columns, "speed_rpm": item.columns["speed_rpm"] + 0.5},
            ), host_ns
        return item, host_ns

    return write_log(tmp_path / "b.mcap", falsify=falsify)


def test_a_true_log_is_identical(capsys: pytest.CaptureFixture[str], log: Path) -> None:
    code, out, _ = run_rig(capsys, str(log), "--check")
    assert code == 0
    assert out.count("identical") == 6
    code, out, _ = run_rig(capsys, str(log), "--check", "--json")
    found = json.loads(out)
    assert (code, found["identical"], found["until_ns"]) == (0, True, None)
    assert found["channels"][0] == {
        "topic": "laser/x",
        "live": 2400,
        "again": 2400,
        "compared": 2400,
        "differing": 0,
        "extra": 0,
        "missing": [],
        "difference": "",
        "fields": {},
        "first": None,
    }


def test_where_it_differs_stands_in_a_table(capsys: pytest.CaptureFixture[str], falsified: Path) -> None:
    code, out, _ = run_rig(capsys, str(falsified), "--check")
    assert code == 1
    with open_log(falsified) as opened:
        speeds, times = opened["motor"].speed_rpm, opened["motor"].time_ns
    wrong = [i for i, speed in enumerate(speeds) if speed % 1]
    row = next(
        line for line in out.splitlines() if line.startswith("motor") and "identical" not in line and "live" not in line
    )
    assert row.split() == [
        "motor",
        str(len(wrong)),
        str(wrong[0]),
        str(times[wrong[0]]),
        "speed_rpm",
        str(speeds[wrong[0]]),
        str(speeds[wrong[0]] - 0.5),
    ]
    code, out, _ = run_rig(capsys, str(falsified), "--json")
    assert code == 0  # only --check makes it a verdict
    motor = next(row for row in json.loads(out)["channels"] if row["topic"] == "motor")
    assert motor["first"]["stored"] == speeds[wrong[0]]
    assert motor["fields"]["speed_rpm"] == {
        "samples": len(wrong),
        "largest": 0.5,
        "rms": pytest.approx(0.5 * (len(wrong) / 60) ** 0.5),
    }


@pytest.mark.parametrize("differs", [False, True])
def test_another_decoder_is_named_and_a_difference_is_still_exit_code_1(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, differs: bool
) -> None:
    def without(number: int, item: Batch | DeviceEvent, host_ns: int) -> tuple[Batch | DeviceEvent, int] | None:
        return None if differs and number == 20 else (item, host_ns)

    log = write_log(tmp_path / "d.mcap", steps=20, falsify=without, decoder="7")
    note = f"recorded by decoder 7, decoded again by decoder {DECODER}: differences are expected"
    code, out, _ = run_rig(capsys, str(log), "--check")
    assert code == int(differs)
    assert f"note: {note}" in out.splitlines()
    code, out, _ = run_rig(capsys, str(log), "--check", "--json")
    found = json.loads(out)
    assert (code, found["identical"], found["notes"]) == (int(differs), not differs, [note])
    assert (found["recorded_by_decoder"], found["decoded_by_decoder"]) == (7, DECODER)
    code, out, _ = run_rig(capsys, str(write_log(tmp_path / "e.mcap", steps=3, decoder=None)), "--json")
    found = json.loads(out)
    assert (found["recorded_by_decoder"], found["decoded_by_decoder"]) == (None, DECODER)


def test_a_damaged_log_states_how_far_it_was_compared(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    part = write_log(tmp_path / "c.mcap", finish=False, unwritten_from=200)
    code, out, _ = run_rig(capsys, str(part), "--check")
    assert code == 0
    assert "note: the log is cut" in out
    for line in out.splitlines():
        if " live " in line and line.split()[1] != line.split()[3]:
            assert "identical as far as compared" in line
    assert "as far as compared" in out


def test_a_new_log_with_corrected_calibration(capsys: pytest.CaptureFixture[str], log: Path, tmp_path: Path) -> None:
    (tmp_path / "better.toml").write_text("[devices.laser_x]\nrange_m = 0.0251\n")
    new = tmp_path / "new.mcap"
    code, out, _ = run_rig(capsys, str(log), "--calibration", str(tmp_path / "better.toml"), "-o", str(new))
    assert code == 0
    assert "laser/x    displacement_m   2400 of 2400 moved" in out
    assert "laser/y    2400 samples, all as they were" in out
    code, out, _ = run_rig(capsys, str(new), "--check")
    assert code == 0
    code, out, _ = run_rig(capsys, str(log), "-o", str(tmp_path / "third.mcap"), "--json")
    assert json.loads(out)["channels"]["laser/x"] == {"origin": 2400, "anew": 2400, "moved": {}}


def test_watched_at_its_pace_without_a_terminal(
    capsys: pytest.CaptureFixture[str], log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(replay_view, "_PLAIN_S", 0.0)
    code, out, err = run_rig(capsys, str(log), "--speed", "max", "--json")
    found = json.loads(out)
    assert code == 0
    assert found["samples"] == {"laser/x": 2400, "laser/y": 2400, "pendulums": 600, "tacho": 60, "motor": 60}
    assert found["ended"] == "end of the log"
    assert found["losses"]["laser_y"]["samples"] == 0
    assert "motor 119 rpm" in err
    assert "θ4   180.00°" in err


def test_ctrl_c_ends_watching_cleanly(
    capsys: pytest.CaptureFixture[str], log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown = [0]

    def interrupted(*_: object) -> None:
        shown[0] += 1
        if shown[0] == 30:
            raise KeyboardInterrupt

    monkeypatch.setattr(replay_view.ReplayView, "add", interrupted)
    code, out, _ = run_rig(capsys, str(log), "--speed", "max", "--json")
    assert code == 0
    assert json.loads(out)["ended"] == "Ctrl-C"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--speed", "fast"], "expected max or a number"),
        (["--speed", "0"], "expected max or a number"),
        (["--calibration", "x.toml"], "-o NEW"),
        (["--check", "--speed", "1"], "one job at a time"),
        (["--check", "--to", "tcp"], "one job at a time"),
        (["-o", "x.mcap", "--speed", "2"], "one job at a time"),
        (["--linger", "3"], "--to"),
        (["--to", "laser_z=/dev/x"], "not of 'laser_z'"),
    ],
)
def test_what_does_not_go_together_is_explained(
    capsys: pytest.CaptureFixture[str], log: Path, arguments: list[str], words: str
) -> None:
    with pytest.raises((LogError, RigFileError), match=words):
        run_rig(capsys, str(log), *arguments)


# --- played to other programs ------------------------------------------------------------------------------------


KINDS = [pytest.param("pty", marks=pytest.mark.skipif(sys.platform == "win32", reason="ptys need POSIX")), "tcp"]


class Player:
    """`rig replay LOG --to …` in its own process.

    Attributes:
        ports: of each device.
        code, result, text: how it ended; known at the end of the with block.
    """

    def __init__(self, log: Path, kind: str, speed: str) -> None:
        command = [sys.executable, "-m", "rig_cli.main", "replay", str(log), "--to", kind, "--speed", speed, "--json"]
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        assert self._process.stdout is not None
        assert self._process.stderr is not None
        self._out: IO[str] = self._process.stdout
        self._words: list[str] = []
        self._listener = threading.Thread(target=self._words.extend, args=(self._process.stderr,))
        self._listener.start()
        self.ports: dict[str, str] = json.loads(self._out.readline())["ports"]
        self.result: dict = {}
        self.code: int | None = None
        self.text = ""

    def __enter__(self) -> Player:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is not None:
            self._process.kill()
        else:
            self.result = json.loads(self._out.readline() or "{}")
        self.code = self._process.wait(timeout=60)
        self._listener.join()
        self.text = "".join(self._words)
        self._out.close()
        assert self._process.stderr is not None
        self._process.stderr.close()


def hosted(player: Player, *command: str) -> subprocess.CompletedProcess[str]:
    """Another `rig` command on the ports of a player, to its end."""
    settings = [word for device, port in player.ports.items() for word in ("--set", f"devices.{device}.port={port}")]
    return subprocess.run(
        [sys.executable, "-m", "rig_cli.main", *command, *settings],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


def drained(ports: dict[str, str], got: dict[str, int]) -> None:
    """Read every port until nothing has come for a while, then close it."""
    links = {device: open_link(port, 921_600, 500_000 if device == "drive" else None) for device, port in ports.items()}
    quiet = 0
    while quiet < 20:
        read = {device: len(link.read(0.02)) for device, link in links.items()}
        quiet = 0 if any(read.values()) or not any(got.values()) else quiet + 1
        for device, count in read.items():
            got[device] = got.get(device, 0) + count
    for link in links.values():
        link.close()


@pytest.mark.parametrize("kind", KINDS)
def test_played_to_another_program_from_start_to_end(log: Path, kind: str) -> None:
    got: dict[str, int] = {}
    with Player(log, kind, "max") as player:
        assert set(player.ports) == {"laser_x", "laser_y", "encoder", "drive"}
        drained(player.ports, got)
    assert player.code == 0
    assert player.result["delivered_bytes"] == got
    assert not any(player.result["undelivered_bytes"].values())
    assert not player.result["configured"]
    assert "rig record" in player.text
    assert "--listen" in player.text
    assert "every port is open" in player.text


@pytest.fixture(scope="module")
def long_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Fourteen seconds of a rotor that runs down and stands at their end; gaps of one laser in the middle."""
    path = tmp_path_factory.mktemp("logs") / "long.mcap"
    return write_log(path, steps=1400, lost=frozenset({400, 401, 403}), rests_from=1250)


@pytest.mark.lengthy
def test_a_check_shows_the_devices_of_the_log(long_log: Path) -> None:
    with Player(long_log, "tcp", "1") as player:  # a busy machine takes its time to open four devices
        host = hosted(player, "check", "virtual", "--seconds", "1", "--json")
    found = json.loads(host.stdout)
    failed = {
        f"{name} {what}"
        for name, device in found["devices"].items()
        for what, one in device["checks"].items()
        if one["verdict"] == "fail"
    }
    assert host.returncode == 3, host.stderr
    # the rotor of the log turns, and its node never answers its status
    clocks = {f"{device} clock_std_us" for device in ("encoder", "laser_x", "laser_y")}
    busy = {"laser_y lost_samples", *clocks}  # the gaps of the log; one second of a machine with other work
    assert failed - busy == {"drive speed_rpm", "encoder status"}
    for name in ("laser_x", "laser_y"):
        known = {**IDENTITIES[name], "driver": "optoncdt", "scaling": "ILD1420"}
        assert known.items() <= found["identities"][name].items()
    assert found["rates_Hz"]["laser/x"] == pytest.approx(4000, rel=0.2)
    assert (player.code, player.result["configured"]) == (0, True)
    assert "not started: drive (the network's start), laser_x (OUTPUT RS422), laser_y" in player.text


@pytest.mark.lengthy
@pytest.mark.parametrize("kind", KINDS)
def test_a_host_that_configures_records_again_what_the_log_holds(long_log: Path, kind: str, tmp_path: Path) -> None:
    again = tmp_path / "again.mcap"
    with Player(long_log, kind, "1") as player:  # fourteen seconds, enough for a host on a busy machine
        host = hosted(player, "record", "virtual", "-o", str(again), "--duration", "3")
    assert host.returncode == 0, host.stderr
    assert player.code == 0
    assert player.result["ended"] == "the host, which stopped its devices and left"
    assert 3.0 < player.result["played_s"] <= 14.01
    with open_log(long_log) as one, open_log(again) as two:
        identities = json.loads(two.attachments["identities.json"])
        known = {**IDENTITIES["laser_x"], "driver": "optoncdt", "scaling": "ILD1420"}
        assert known.items() <= identities["laser_x"].items()
        assert check(again).identical
        for topic, key in (
            ("laser/x", "counter"),
            ("laser/y", "device_ticks"),
            ("pendulums", "index"),
            ("tacho", "revolutions"),
            ("motor", "speed_rpm"),
        ):
            _same_stretch(one[topic], two[topic], key)


def _same_stretch(one: Samples, two: Samples, key: str) -> None:
    """Everything recorded again is, sample by sample and bit by bit, a stretch of the first recording."""
    count = len(two.time_ns)
    assert count > 0.15 * len(one.time_ns)
    # A value of `key` may stand twice in a row (the speed does): the start is the one from which all values follow.
    starts = np.flatnonzero(one[key][: len(one.time_ns) - count + 1] == two[key][0])
    first = next(int(k) for k in starts if np.array_equal(one[key][k : k + count], two[key]))
    stretch = slice(first, first + count)
    assert np.array_equal(one.sequence[stretch], two.sequence)
    for name in one.columns:
        known = slice(None)
        if name == "target_rpm":  # what the host of the log sent before is not on the bus any more
            known = slice(int(np.argmax(two[name] != 0)), None)
            assert known.start <= 8
        assert one[name][stretch][known].tobytes() == two[name][known].tobytes()


def test_a_host_that_gives_up_is_reported_what_it_did_not_do(log: Path) -> None:
    with Player(log, "tcp", "1") as player:
        links = {device: open_link(port, 921_600) for device, port in player.ports.items()}
        links["laser_x"].write(b"GETINFO\n")
        heard = b""
        while not heard.endswith(b"->"):
            heard += links["laser_x"].read(5.0)
        for link in links.values():
            link.close()
    assert b"Name: ILD1420" in heard
    assert player.code == 3
    assert "closed its ports before it had set up its devices; still expected" in player.text
