"""Starting the virtual rig beside us, and the simulated operator at its control port."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
from types import TracebackType
from typing import Any

from daq.errors import DeviceError
from daq.virtual_rig.control import OperatorLine


class VirtualRigProcess:
    """A virtual rig in a process of its own.

    Args:
        rig: path or name of the rig file.
        settings: `--set` texts to lay over it.
        time_scale: seconds of rig time per wall second.
        link: "pty", "tcp" or "auto".
    """

    def __init__(self, rig: str, settings: list[str], time_scale: float, link: str = "auto") -> None:
        command = [sys.executable, "-m", "cli.main", "virtual", rig, "--time-scale", str(time_scale), "--link", link]
        for setting in settings:
            command += ["--set", setting]
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        try:
            ready = json.loads(line)
        except ValueError:
            self._process.wait(timeout=10)
            raise DeviceError(f"the virtual rig did not start (exit {self._process.returncode}): {line!r}") from None
        self.ports: dict[str, str] = ready["ports"]
        self.line = OperatorLine(ready["control_port"], ready["token"])

    def port_settings(self) -> list[str]:
        """Settings that point a rig file's devices at this process."""
        return [f"devices.{name}.port={json.dumps(port)}" for name, port in self.ports.items()]

    def __enter__(self) -> VirtualRigProcess:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with contextlib.suppress(OSError, ValueError):
            self.line.ask("quit")
        self.line.close()
        try:
            self._process.wait(timeout=5)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()


class SimulatedOperator:
    """Does at the virtual rig what a person does by hand at a real one."""

    def __init__(self, line: OperatorLine) -> None:
        self._line = line

    def pluck(self, axis: str) -> None:
        """Displace mostly along the axis, as well as a hand can, and let go."""
        x, y = (2.6, 0.25) if axis == "x" else (-0.2, 2.4)
        self._line.ask("pluck", x_mm=x, y_mm=y, hold_s=0.4)

    def flick(self) -> None:
        """Set the pendulums spinning, one each way."""
        self._line.ask("flick", pendulum=0, speed_rad_s=11.5)
        self._line.ask("flick", pendulum=1, speed_rad_s=-10.8)

    def radio(self) -> dict[str, Any]:
        """What the radio dropped, as only an onlooker of a simulation can know."""
        return self._line.ask("radio")
