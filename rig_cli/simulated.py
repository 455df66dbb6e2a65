"""The virtual rig as a child process."""

from __future__ import annotations

import json
import logging
import subprocess
import sys
from types import TracebackType
from typing import Any

from daq.errors import DeviceError
from daq.transports import HostClock
from daq.virtual_rig.control import OperatorLine
from rig_basics.ignoring import ignoring

_log = logging.getLogger(__name__)


class VirtualRigProcess:
    """A virtual rig in a process of its own.

    Args:
        rig: path or name of the rig file.
        settings: `--set` texts over it.
        link: "pty", "tcp" or "auto".

    Attributes:
        clock: clock of the program that runs the rig.
        edge: None: the machine's own ports and disk are used.
    """

    edge = None

    def __init__(self, rig: str, settings: list[str], link: str = "auto") -> None:
        command = [sys.executable, "-m", "rig_cli.main", "virtual", rig, "--link", link]
        command += ["--while-stdin-open"]  # it ends with this process, also if this process is killed
        for setting in settings:
            command += ["--set", setting]
        self.clock: HostClock = HostClock()
        # its own session: Ctrl-C reaches this process alone, and the wires stay until the rotor has been stopped
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=sys.platform != "win32"
        )
        try:
            ports, line = self._connect()
            self.ports: dict[str, str] = ports
            self.line: OperatorLine = line
        except BaseException:
            self._end()
            raise

    def _connect(self) -> tuple[dict[str, str], OperatorLine]:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        try:
            ready = json.loads(line)
        except ValueError:
            raise DeviceError(f"the virtual rig did not start, it printed {line!r}; its error is above") from None
        return ready["ports"], OperatorLine(ready["control_port"], ready["token"])

    def ask(self, do: str, **what: Any) -> dict[str, Any]:
        """See OperatorLine."""
        return self.line.ask(do, **what)

    def port_settings(self) -> list[str]:
        """Return settings that point a rig file's devices at this process."""
        return [f"devices.{name}.port={json.dumps(port)}" for name, port in self.ports.items()]

    def __enter__(self) -> VirtualRigProcess:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with ignoring(_log, "ending the virtual rig", OSError, ValueError):
            self.line.ask("quit")
        with ignoring(_log, "closing the operator's line", OSError, ValueError):
            self.line.close()
        self._end()

    def _end(self) -> None:
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with ignoring(_log, "closing a pipe of the virtual rig", OSError):
                    pipe.close()
        try:
            self._process.wait(timeout=5)
        except subprocess.TimeoutExpired as error:
            _log.info("the virtual rig is killed: %s", error)
            self._process.kill()
            self._process.wait()
