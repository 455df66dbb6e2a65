"""Printed text that cannot be written is lost; the command goes on."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tracemalloc
from pathlib import Path

import pytest

from rig_cli.streams import MessageStream

ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="/dev/full, closed descriptors and signals of POSIX")
ENTRY = "import sys; from rig_cli.entry import main; sys.argv[0] = 'rig'; main()"


def rig(arguments: list[str], streams: str, before: str = "") -> subprocess.CompletedProcess[str]:
    """Run a command with the shell's redirections `streams`, after the Python statements `before`."""
    command = [sys.executable, "-c", f"{before}\n{ENTRY}", *arguments]
    shell = ["sh", "-c", f'exec "$@" {streams}', "sh", *command]
    return subprocess.run(shell, cwd=ROOT, capture_output=True, text=True, timeout=120, check=False)


@pytest.mark.parametrize("streams", [">/dev/full", ">&-"])
@pytest.mark.parametrize("arguments", [["logs", "examples", "--json"], ["--help"]])
def test_results_that_cannot_be_written_are_an_i_o_fault(arguments: list[str], streams: str) -> None:
    done = rig(arguments, streams)
    assert done.returncode == 3
    (line,) = done.stderr.splitlines()
    assert line.startswith("rig: standard output cannot be written (")


def test_an_error_keeps_its_code_where_its_object_cannot_be_written() -> None:
    done = rig(["predict", "absent.toml", "--json"], ">/dev/full")
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert line.startswith("rig: absent.toml: no such rig file")


def test_a_reader_that_is_gone_ends_a_command_without_words() -> None:
    ours, theirs = os.pipe()
    os.close(ours)
    ended = subprocess.run(
        [sys.executable, "-c", ENTRY, "--help"], cwd=ROOT, stdout=theirs, stderr=subprocess.PIPE, check=False
    )
    os.close(theirs)
    assert (ended.returncode, ended.stderr) == (141, b"")


@pytest.mark.parametrize("streams", ["2>/dev/full", "2>&-"])
def test_messages_that_cannot_be_written_change_no_result(streams: str) -> None:
    done = rig(["logs", "absent", "--json"], streams)
    assert done.returncode == 2
    assert json.loads(done.stdout)["exit_code"] == 2


def test_no_file_of_a_command_gets_the_number_of_a_closed_stream(tmp_path: Path) -> None:
    program = (
        "from rig_cli.streams import open_streams; open_streams(); import sys\n"
        f"file = open({str(tmp_path / 'log')!r}, 'w'); print('lost', file=sys.stderr); sys.exit(file.fileno() > 2)"
    )
    shell = f'exec "{sys.executable}" -c "$1" <&- >&- 2>&-'
    assert subprocess.run(["sh", "-c", shell, "sh", program], cwd=ROOT, check=False).returncode == 1
    assert (tmp_path / "log").read_text() == ""


def test_a_held_terminal_delays_no_message_and_gets_all_of_them() -> None:
    ours, theirs = os.pipe()
    stream = MessageStream(theirs, "utf-8")
    lines = [f"{number} µm {'x' * 100}\n" for number in range(10_000)]  # a megabyte, the pipe holds 64 kB
    for line in lines:
        print(line, end="", file=stream, flush=True)
    read = bytearray()
    while len(read) < sum(len(line.encode()) for line in lines):
        read += os.read(ours, 1 << 16)
    stream.finish()
    os.close(ours)
    os.close(theirs)
    assert read.decode() == "".join(lines)


def test_what_waits_for_a_held_terminal_is_limited() -> None:
    ours, theirs = os.pipe()
    stream = MessageStream(theirs, "utf-8")
    for _ in range(300_000):
        stream.write("x" * 100)
    tracemalloc.start()
    for _ in range(300_000):
        stream.write("x" * 100)
    kept, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    os.close(ours)
    stream.finish()
    os.close(theirs)
    assert kept < 1_000_000  # of 30 MB


@pytest.mark.parametrize("gone", ["reader", "descriptor"])
def test_a_terminal_that_is_gone_raises_no_error(gone: str) -> None:
    ours, theirs = os.pipe()
    os.close(ours)
    if gone == "descriptor":
        os.close(theirs)
    stream = MessageStream(theirs, "ascii")
    for _ in range(100):
        print("3 µm \udcff", file=stream, flush=True)
    stream.finish()
    if gone == "reader":
        os.close(theirs)


@pytest.mark.parametrize("columns", ["0", "1", "²", "9" * 5000])
def test_no_width_of_the_terminal_takes_long(columns: str) -> None:
    narrow = f"import os; os.environ['COLUMNS'] = {columns!r}"
    done = rig(["import", "--help"], "", narrow)
    assert done.returncode == 0
    assert "--time" in done.stdout
    assert max(map(len, done.stdout.splitlines())) <= 1000


INTERRUPTED = "import rig_cli.main\ndef commands(*_): raise KeyboardInterrupt\nrig_cli.main.commands = commands\n"
AT_THE_END = "import atexit, os, signal; atexit.register(lambda: os.kill(os.getpid(), signal.SIGINT))\n"


def test_a_second_ctrl_c_while_the_program_ends_keeps_the_exit_code() -> None:
    done = rig(["predict", "virtual"], "", AT_THE_END + INTERRUPTED)
    assert (done.returncode, done.stderr) == (130, "rig: interrupted\n")
    done = rig(["--version"], "", AT_THE_END)
    assert (done.returncode, done.stderr) == (0, "")


DROPPED = """
import signal, sys, threading
from rig_cli.signals import interrupt_at_signals
signal.signal(signal.SIGINT, signal.default_int_handler)
interrupt_at_signals()
class Last:
    def __del__(self): raise KeyboardInterrupt({by!r})
try:
    Last()
    threading.Event().wait(30)
except KeyboardInterrupt as stop:
    sys.exit(f"interrupted {{stop}}")
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no signal to a thread")
@pytest.mark.parametrize("by", ["", "SIGTERM"])
def test_an_interruption_that_a_finalizer_drops_comes_again(by: str) -> None:
    done = subprocess.run([sys.executable, "-c", DROPPED.format(by=by)], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr.strip()) == (1, f"interrupted {by}".strip())


@pytest.mark.parametrize(("ignored", "code"), [(True, 0), (False, 130)])
def test_a_hang_up_that_is_ignored_at_the_start_stays_ignored(ignored: bool, code: int) -> None:
    hang_up = (
        "import os, signal\n"
        f"signal.signal(signal.SIGHUP, signal.{'SIG_IGN' if ignored else 'SIG_DFL'})\n"
        "import rig_cli.main\n"
        "def commands(*_): os.kill(os.getpid(), signal.SIGHUP); return lambda *_, **__: 0\n"
        "rig_cli.main.commands = commands\n"
    )
    assert rig(["predict", "virtual"], "", hang_up).returncode == code
