"""Ports of a rig file that are a person's terminal by now."""

from __future__ import annotations

import os
import select
import subprocess
import sys
from pathlib import Path

import pytest

from daq.errors import LinkLost
from daq.transports import open_link

if sys.platform != "win32":
    import termios

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="only Linux lists the terminals of other processes")


@pytest.mark.parametrize("named", ["itself", "by a link"])
def test_the_terminal_of_another_program_is_not_opened(named: str, tmp_path: Path) -> None:
    """A rig file may name a pty that is a person's terminal by now: no byte, and its settings stay."""
    master, slave = os.openpty()
    name = os.ttyname(slave)
    port = tmp_path / "drive"
    port.symlink_to(name)
    takes_it = "import os, fcntl, termios; os.setsid(); fcntl.ioctl(0, termios.TIOCSCTTY, 0); print(1); input()"
    with subprocess.Popen([sys.executable, "-u", "-c", takes_it], stdin=slave, stdout=subprocess.PIPE) as shell:
        assert shell.stdout.readline() == b"1\n"
        before = termios.tcgetattr(slave)
        with pytest.raises(LinkLost, match=rf"is the terminal of process {shell.pid} .*it was not opened"):
            open_link(name if named == "itself" else str(port), 115_200)
        assert termios.tcgetattr(slave) == before
        assert select.select([master], [], [], 0)[0] == []
        os.write(master, b"\n")
    open_link(name, 115_200).close()  # of no process any more
    os.close(master)
    os.close(slave)
