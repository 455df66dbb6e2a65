"""Guided tests on the virtual rig from Python, in one thread and simulated time, repeatable by the seed."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import TracebackType

from daq.acquisition.session import Session
from daq.guided_tests.hands import Progress
from daq.guided_tests.procedure import Procedures, TestDone
from daq.lockstep.rig import LockstepRig
from daq.virtual_rig.simulated_operator import SimulatedOperator
from rig_configs import IdentifiedParameters, RigFileError, load_rig, parse_setting, with_parameters
from rig_configs.load import with_truth
from rig_configs.schema import Rig


class Rehearsal:
    """An open virtual rig with a simulated operator. Logs, drivers and tests are the same as on a real rig.

    The constructor opens the rig. Call `close` at the end, or use a `with` statement.

    Args:
        rig: name or path of a rig file with a [virtual] table.
        folder: folder of the logs, created if it is missing. Names are numbered; no file is overwritten.
        settings: settings KEY=VALUE that replace values of the rig file. `virtual.seed=3` changes noise, clocks and
            calibration errors.
        progress: called with a description of the progress and the completed share, 0 … 1 (None if unknown).

    Attributes:
        rig: the rig file with the ports of this rig.

    Raises:
        RigFileError: the rig file is invalid, or has no [virtual] table.
    """

    def __init__(
        self,
        rig: str | Path,
        folder: str | Path,
        settings: tuple[str, ...] | list[str] = (),
        progress: Progress | None = None,
    ) -> None:
        loaded = load_rig(rig, settings=list(settings))
        if loaded.virtual is None:
            raise RigFileError(f"{rig}: expected a rig file with a [virtual] table, as the shipped `virtual` has")
        self._far = LockstepRig(loaded)
        self.rig: Rig = load_rig(rig, settings=[*settings, *self._far.port_settings()])
        Path(folder).mkdir(parents=True, exist_ok=True)
        self._session = Session(self.rig, self._far.clock, edge=self._far.edge)
        self._session.__enter__()
        self._tests = Procedures(self._session, SimulatedOperator(self._far), Path(folder), progress or _no_progress)

    @property
    def truth(self) -> Mapping[str, float]:
        """True parameters of the rig at present, by the names of parameters.toml. Tests do not use them."""
        return self._far.ask("truth")["truth"]

    def record(self, test: str, parameters: IdentifiedParameters | None = None, **numbers: float) -> TestDone:
        """Run a guided test and record its log.

        Args:
            test: name of the test as in `rig test`: ring-down-x, ring-down-y, spin-down, run-up, run-down, point-A …
            parameters: identified parameters from which the speeds follow; None for those of the rig file.
            numbers: numbers that replace the defaults of the test, for example `top_rpm=900`.

        Returns:
            Result with `log`, `missed` and `warnings`.

        Raises:
            GuidedTestRefused: the rig cannot run the requested test.
            NotReached: the test ended before its log began.
            AcquisitionError: an interlock or a device ended the test.
        """
        rig = self.rig if parameters is None else with_parameters(self.rig, parameters)
        name = "" if parameters is None else "identified parameters"
        return self._tests.run(test, rig, point="", parameters=name, **numbers)

    def change(self, setting: str) -> None:
        """Change the simulated hardware, as a person changes a real rig between two tests.

        Args:
            setting: KEY=VALUE with a key of the rig file, for example `suspension.k2_N_per_m=+7%`.

        Raises:
            RigFileError: the key does not exist, or the value is invalid.
        """
        key, value = parse_setting(setting)
        with_truth(self.rig, key, value)  # raises RigFileError, which names the keys of the rig file
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


def _no_progress(text: str, share: float | None) -> None:
    """Ignore the progress."""
