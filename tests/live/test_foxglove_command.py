"""`--foxglove` as a command's option: off by default, reported in a line, on the loopback, ended with the run."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from subprocess import PIPE

import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Origin, Subprotocol

from live.foxglove.protocol import SUBPROTOCOLS
from rig_cli.simulated import VirtualRigProcess

RIG = [sys.executable, "-m", "rig_cli.main"]
OURS = [Subprotocol("foxglove.sdk.v1")]
PAGE = "https://lichtblick.example"


def _begun(running: subprocess.Popen[str]) -> str:
    """Address of the connection in a line of JSON."""
    assert running.stdout is not None
    for line in running.stdout:
        if "foxglove" in (line_json := json.loads(line)):
            return line_json["foxglove"]
    raise AssertionError("no line contains it")


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGTERM")
def test_a_log_is_given_until_the_command_ends(point_log: Path) -> None:
    command = [*RIG, "live", str(point_log), "--json", "--foxglove", "--foxglove-port", "0", "--foxglove-origin", PAGE]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as running:
        try:
            url = _begun(running)
            assert url.startswith("ws://127.0.0.1:")
            with pytest.raises(InvalidStatus), connect(url, subprotocols=OURS, origin=Origin("https://evil.example")):
                pass
            with connect(url, subprotocols=OURS, origin=Origin(PAGE)) as line:
                assert json.loads(line.recv(timeout=30))["name"] == point_log.name
                topics = {each["topic"] for each in json.loads(line.recv(timeout=30))["channels"]}
                assert {"laser/x", "laser/y", "pendulums", "motor", "events"} <= topics
                assert isinstance(line.recv(timeout=30), bytes), "its clock goes on"
                running.send_signal(signal.SIGTERM)
                assert all(isinstance(data, bytes) for data in line), "ended as it should be"
            rest, output = running.communicate(timeout=30)
        finally:
            running.kill()
    assert (running.returncode, rest) == (0, "")
    assert f"{url}; read-only and without a token: any user of this machine can read it" in output
    assert "a page of https://evil.example asked for the rig's data and was refused" in output
    assert "begin with --foxglove-origin https://evil.example" in output


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGTERM")
def test_a_recording_is_given_while_it_runs(virtual_rig: VirtualRigProcess, tmp_path: Path) -> None:
    settings = [part for setting in virtual_rig.port_settings() for part in ("--set", setting)]
    command = [*RIG, "record", "virtual", "-o", str(tmp_path / "a.mcap")]
    with subprocess.Popen(
        [*command, "--json", "--foxglove", "--foxglove-port", "0", *settings],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as running:
        try:
            with connect(_begun(running), subprotocols=OURS) as line:
                line.recv(timeout=30)
                line.recv(timeout=30)
                line.send('{"op": "subscribe", "subscriptions": [{"id": 9, "channelId": 1}]}')
                while (data := line.recv(timeout=60))[0] == 2:  # the clock alone, until it records
                    pass
                assert data[:5] == b"\x01\x09\x00\x00\x00"
                running.send_signal(signal.SIGTERM)
                for _ in line:
                    pass
            rest, output = running.communicate(timeout=60)
        finally:
            running.kill()
    assert running.returncode == 0, output
    assert json.loads(rest)["log"].endswith("a.mcap")


@pytest.mark.parametrize(
    ("options", "code", "why"),
    [
        (["--foxglove-port", "70000"], 3, "127.0.0.1:70000: the connection for Foxglove cannot be offered"),
        (["--foxglove-origin", "app.foxglove.dev"], 2, "expected a page's scheme"),
        (["--foxglove-origin", "*"], 2, "expected a page's scheme"),
        (["--foxglove-origin", "https://app.foxglove.dev/"], 2, "expected a page's scheme"),
        (["--foxglove-host", "0.0.0.0"], 2, "--foxglove-host"),
    ],
)
def test_what_cannot_be_is_refused_in_words(point_log: Path, options: list[str], code: int, why: str) -> None:
    done = subprocess.run(
        [*RIG, "live", str(point_log), "--json", "--foxglove", *options],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == code, done.stderr
    assert why in json.loads(done.stdout.splitlines()[-1])["error"]


_FEW_FILES = 96
_SERVER = f"""
import resource, sys
from live.foxglove.server import FoxgloveServer
resource.setrlimit(resource.RLIMIT_NOFILE, ({_FEW_FILES}, {_FEW_FILES}))
with FoxgloveServer("rig", [], {{}}, port=0) as server:
    print(server.url, flush=True)
    sys.stdin.read()
"""


@contextmanager
def _out_of_files() -> Iterator[str]:
    """Address of a server with more connections than its process has files."""
    with (
        subprocess.Popen([sys.executable, "-c", _SERVER], stdin=PIPE, stdout=PIPE, stderr=PIPE, text=True) as server,
        ExitStack() as idle,
    ):
        assert server.stdout is not None
        url = server.stdout.readline().strip()
        address = url.removeprefix("ws://").rsplit(":", 1)
        for _ in range(_FEW_FILES + 10):
            idle.enter_context(socket.create_connection((address[0], int(address[1])), timeout=5))
        yield url
        _, printed = server.communicate("", timeout=20)
        assert printed == ""
        assert server.returncode == 0


@pytest.mark.skipif(sys.platform == "win32", reason="limits of files need POSIX")
def test_idle_connections_end_and_leave_the_terminal_quiet() -> None:
    """The page of a session closes them too; here each of them made the event loop print tracebacks."""
    with (
        _out_of_files() as url,
        connect(url, subprotocols=[Subprotocol(SUBPROTOCOLS[0])], open_timeout=30) as client,
    ):
        assert json.loads(client.recv(timeout=5))["op"] == "serverInfo"


@pytest.mark.skipif(sys.platform == "win32", reason="limits of files need POSIX")
def test_a_server_that_ends_while_connections_wait_for_a_file_leaves_the_terminal_quiet() -> None:
    """The event loop retries to accept them after a second, on a socket that is closed by then."""
    with _out_of_files():
        pass
