"""`rig live` as a command: its first line, what it refuses, how it ends."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from http.client import HTTPConnection
from pathlib import Path
from urllib.parse import urlsplit

import pytest

RIG = [sys.executable, "-m", "rig_cli.main", "live"]


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGTERM")
def test_the_first_line_is_the_address_and_sigterm_ends_it(point_log: Path) -> None:
    running = subprocess.Popen(
        [*RIG, str(point_log), "--json"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        assert running.stdout is not None
        address = json.loads(running.stdout.readline())
        assert set(address) == {"url", "token"}
        parts = urlsplit(address["url"])
        assert parts.hostname == "127.0.0.1"
        assert parts.query == f"token={address['token']}"
        found: dict[str, int] = {}
        for path in (f"/?{parts.query}", "/", f"/page/bokeh.min.js?{parts.query}", "/page/bokeh.min.js"):
            connection = HTTPConnection(parts.netloc, timeout=30)
            connection.request("GET", path)
            answer = connection.getresponse()
            found[path.replace(address["token"], "T")] = answer.status
            assert len(answer.read()) > (1_000_000 if answer.status == 200 and "bokeh" in path else 20)
            connection.close()
        assert found == {
            "/?token=T": 200,
            "/": 403,
            "/page/bokeh.min.js?token=T": 200,
            "/page/bokeh.min.js": 403,
        }
        running.send_signal(signal.SIGTERM)
        rest, output = running.communicate(timeout=30)
    finally:
        running.kill()
        running.wait()
    assert (running.returncode, rest) == (0, "")
    assert address["url"] in output


@pytest.mark.parametrize(
    ("options", "code", "why"),
    [(["--speed", "1000"], 2, "expected a speed of 0.01 to 100"), (["--host", "0.0.0.0"], 3, "not all of them")],
)
def test_what_cannot_be_is_refused_in_words(point_log: Path, options: list[str], code: int, why: str) -> None:
    done = subprocess.run(
        [*RIG, str(point_log), "--json", *options], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == code, done.stderr
    assert why in json.loads(done.stdout)["error"]
    assert why in done.stderr


def test_a_host_is_warned_of_and_still_asks_for_the_token(point_log: Path) -> None:
    running = subprocess.Popen(
        [*RIG, str(point_log), "--json", "--host", "localhost"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert running.stdout is not None
        parts = urlsplit(json.loads(running.stdout.readline())["url"])
        assert parts.hostname == "localhost"
        connection = HTTPConnection(parts.netloc, timeout=30)
        connection.request("GET", "/")
        status = connection.getresponse().status
        connection.close()
        assert status == 403
    finally:
        running.terminate()
        _, output = running.communicate(timeout=30)
    assert "warning: --host localhost" in output
