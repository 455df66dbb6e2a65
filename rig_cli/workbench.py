"""Identification and validation of `rig demo` in their own process: fitting never delays the drive's heartbeat."""

from __future__ import annotations

import contextlib
import importlib
import queue
from collections.abc import Callable
from concurrent.futures import Future
from multiprocessing.queues import Queue
from pathlib import Path
from typing import Any, TypeVar

from rig_basics.worker_processes import WORKERS, worker_pool
from rig_configs.schema import Rig

_worker: dict[str, Any] = {}  # state of the worker process between two jobs of one campaign
_POLL_S = 0.2
_Result = TypeVar("_Result")


def _notify(text: str) -> None:
    _worker["messages"].put(text)


def _begin_work(messages: Queue[str]) -> None:
    """Prepare the worker before its first job: send progress messages to a queue."""
    _worker.update(messages=messages, runs=[], joint=None)


def _warm_up() -> None:
    """Import and compile what the conclusion needs, while the points are being recorded."""
    import numpy as np

    from dynamics import SpeedHistory, simulate, steady_states
    from dynamics.equations.scene import Scene
    from rig_configs import load_rig

    for module in ("analysis.report.write", "analysis.validation"):
        importlib.import_module(module)
    physics = load_rig("virtual").physics
    simulate(physics, Scene(SpeedHistory.constant(30.0)), np.linspace(0, 0.1, 11))
    steady_states(physics, 30.0)


def _refine(rig: Rig, logs: list[Path]) -> None:
    """Add tests to the joint estimate. Tests that determine nothing wait for further ones."""
    from identification import NotIdentifiable, identify
    from studies.runs import load_runs

    _worker["runs"] += load_runs(logs)
    with contextlib.suppress(NotIdentifiable):  # usual: `_identify` reports what is missing
        _worker["joint"] = identify(_worker["runs"], rig, _notify, earlier=_worker["joint"])


def _identify(rig: Rig, out: Path) -> dict[str, Any]:
    """Write the joint estimate as that before the points."""
    from identification import identify
    from rig_cli import results

    found = identify(_worker["runs"], rig, _notify, earlier=_worker["joint"])
    results.with_version(found.parameters).save(out)
    _worker.update(before=found, joint=found)
    return results.identification_json(found)


def _conclude(rig: Rig, out: Path, report: Path, facts: dict[str, Any]) -> dict[str, Any]:
    """Validate the points with the parameters identified before them; write joint parameters and report."""
    from daq.guided_test_kinds import point_of
    from daq.guided_tests.test_inputs import possible_tests
    from rig_cli import results
    from rig_cli.reporting import reported
    from studies.validated_runs import keep_verdicts, validated

    runs, before, joint = _worker["runs"], _worker["before"], _worker["joint"]
    points = {point_of(test) for test in possible_tests(rig)}
    tested = rig.model_copy(update={"points": {name: point for name, point in rig.points.items() if name in points}})
    validation = validated(runs, tested, before.parameters, _notify)
    keep_verdicts(validation, runs, facts["validated_with"])
    results.with_version(joint.parameters).save(out)
    reported(report, tested, runs, before.parameters, joint, validation, facts=facts)
    losses = {Path(run.source).name: dict(run.losses) for run in runs}
    return {
        **results.identification_json(joint),
        **validation.to_json(),
        "warnings": [*joint.warnings, *validation.warnings],
        "passed": validation.passed if tested.points else None,  # a rig without sensors for a point has no verdict
        "losses": losses,
        "lines": results.parameter_lines(joint.parameters, facts["truth"]),
    }


class Workbench:
    """One worker process that carries out jobs in the order given."""

    def __init__(self) -> None:
        self._messages: Queue[str] = WORKERS.Queue()
        self._ending = contextlib.ExitStack()
        self._pool = self._ending.enter_context(worker_pool(1, _begin_work, self._messages))

    def refine(self, rig: Rig, logs: list[Path]) -> Future[None]:
        """Add tests to the joint estimate, while the next ones are being recorded."""
        return self._pool.submit(_refine, rig, logs)

    def identify(self, rig: Rig, out: Path) -> Future[dict[str, Any]]:
        """Write the estimate from the tests so far to parameters.toml, as that before the points."""
        job = self._pool.submit(_identify, rig, out)
        self._pool.submit(_warm_up)
        return job

    def conclude(self, rig: Rig, out: Path, report: Path, facts: dict[str, Any]) -> Future[dict[str, Any]]:
        """Validate, write joint parameters and report."""
        return self._pool.submit(_conclude, rig, out, report, facts)

    def wait(self, job: Future[_Result], notify: Callable[[str], None]) -> _Result:
        """Wait for a job's result.

        Args:
            notify: called with the latest progress message of the worker.
        """
        while True:
            latest = None
            with contextlib.suppress(queue.Empty):  # usual: all messages are read
                while True:
                    latest = self._messages.get_nowait()
            if latest is not None:
                notify(latest)
            try:
                return job.result(timeout=_POLL_S)
            except TimeoutError:
                if job.done():
                    raise

    def close(self) -> None:
        """End the worker and cancel its jobs."""
        self._ending.close()
