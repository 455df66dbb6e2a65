"""A command of the host whose virtual rig shares its time, so that time stops while the machine keeps either waiting.

Started as `python -m tests.paced_command FILE COMMAND ...`; FILE is that of the rig's clock.
"""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path
from unittest.mock import patch

from daq.transports.paced_clock import PacedClock
from rig_cli.main import main


class _Joined(PacedClock):
    """The host's side of a clock whose file exists."""

    def __init__(self, file: str, rate: float) -> None:
        super().__init__(rate, Path(file))
        self._leads = False


if __name__ == "__main__":
    joined = partial(_Joined, sys.argv.pop(1))
    with patch("rig_cli.guided_test.HostClock", joined), patch("rig_cli.acquire.HostClock", joined):
        main()
