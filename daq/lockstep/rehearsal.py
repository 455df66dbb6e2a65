# pyright: strict
"""Guided tests on the virtual rig from Python: one thread, simulated time, the same bytes for the same seed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

from daq.acquisition.session import Session
from daq.guided_tests.procedure import Procedures, TestDone
from daq.lockstep.rig import LockstepRig
from daq.virtual_rig.simulated_operator import SimulatedOperator
from rig_configs import IdentifiedParameters, RigFileError, load_rig, parse_setting, with_parameters
from rig_configs.load import with_truth


class Rehearsal:
    """An open virtual rig with an operator at it. Logs, drivers and tests are those of a real rig.

    It is opened when made; `close` it, or use it in a `with` statement.

    Args:
        rig: a rig file's name or path; it needs a [virtual] table.
        folder: where logs go, made where it is missing. Names are counted up, nothing is written over.
        settings: `--set` texts over the rig file; `virtual.seed=3` draws other noise, clocks and calibration errors.
        tell: told what is going on and the share done where that is known.

    Attributes:
        rig: the rig file with this rig's ports.

    Raises:
        RigFileError: the rig file is wrong, or has no [virtual] table.
    """

    def __init__(
        self,
        rig: str | Path,
        folder: str | Path,
        settings: tuple[str, ...] | list[str] = (),
        tell: Callable[[str, float | None], None] | None = None,
    ) -> None:
        loaded = load_rig(rig, settings=list(settings))
        if loaded.virtual is None:
            raise RigFileError(f"{rig}: expected a rig file with a [virtual] table, as the shipped `virtual` has")
        self._far = LockstepRig(loaded)
        self.rig = load_rig(rig, settings=[*settings, *self._far.port_settings()])
        Path(folder).mkdir(parents=True, exist_ok=True)
        self._session = Session(self.rig, self._far.clock, edge=self._far.edge)
        self._session.__enter__()
        self._tests = Procedures(self._session, SimulatedOperator(self._far), Path(folder), tell or _tell_nobody)

    @property
    def truth(self) -> Mapping[str, float]:
        """What the rig really is now, by the names of parameters.toml; nothing that measures can see it."""
        return self._far.ask("truth")["truth"]

    def record(self, test: str, parameters: IdentifiedParameters | None = None, **numbers: float) -> TestDone:
        """Run a guided test and keep its log.

        Args:
            test: as `rig test` takes it: ring-down-x, ring-down-y, spin-down, run-up, run-down, point-A …
            parameters: from which the test's speeds follow; None for the rig file's own.
            numbers: of the test that are not to be its own, as `top_rpm=900`.

        Returns:
            Its `log`, what was `missed`, and `warnings`.

        Raises:
            Refused: the rig cannot run it so.
            NotReached: it ended before a log began.
            RigError: an interlock or a device ended it.
        """
        rig = self.rig if parameters is None else with_parameters(self.rig, parameters)
        self._tests.parameters = "" if parameters is None else "identified parameters"
        return self._tests.run(test, rig, point="", **numbers)

    def change(self, setting: str) -> None:
        """Change the rig's hardware, as a person would between two tests.

        Args:
            setting: KEY=VALUE by the names of the rig file, as `suspension.k2_N_per_m=+7%`.

        Raises:
            RigFileError: no such number, or one that cannot be.
        """
        key, value = parse_setting(setting)
        with_truth(self.rig, key, value)  # says what is wrong with it, in the rig file's words
        self._far.ask("set", key=key.removeprefix("virtual.truth."), value=value)

    def close(self) -> None:
        """Stop the rotor and close the devices."""
        self._session.__exit__(None, None, None)

    def __enter__(self) -> Rehearsal:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._session.__exit__(kind, error, trace)


def _tell_nobody(text: str, share: float | None) -> Any:
    """Nobody is told."""
