"""The offline half of a campaign, in a process of its own so that fitting never delays the drive's heartbeat."""

from __future__ import annotations

import contextlib
import importlib
import multiprocessing
import queue
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor
from multiprocessing.connection import Connection
from multiprocessing.queues import Queue
from pathlib import Path
from typing import Any, TypeVar

from rig_configs.schema import Rig
from studies.engines.lifeline import end_with_parent

_found: dict[str, Any] = {}  # the worker's own memory between two jobs of one campaign
_TOLD_EVERY_S = 0.2
_Result = TypeVar("_Result")


def _tell(text: str) -> None:
    _found["told"].put(text)


def _begin_work(lifeline: Connection, told: Queue[str]) -> None:
    """In the worker, before its first job: end with the parent, and know where to say what a job is at."""
    end_with_parent(lifeline)
    _found["told"] = told


def _warm_up() -> None:
    """Import and compile while the first tests are being recorded."""
    import numpy as np  # noqa: PLC0415

    from dynamics import SpeedHistory, simulate, steady_states  # noqa: PLC0415
    from dynamics.equations.scene import Scene  # noqa: PLC0415
    from rig_configs import load_rig  # noqa: PLC0415

    for module in ("analysis.report.write", "analysis.validation", "identification"):
        importlib.import_module(module)
    physics = load_rig("virtual").physics
    simulate(physics, Scene(SpeedHistory.constant(30.0)), np.linspace(0, 0.1, 11))
    steady_states(physics, 30.0)


def _identify(rig: Rig, logs: list[Path], out: Path) -> dict[str, Any]:
    from rig_cli import results  # noqa: PLC0415
    from identification import identify  # noqa: PLC0415
    from studies.runs import load_runs  # noqa: PLC0415

    runs = load_runs(logs)
    found = identify(runs, rig, _tell)
    results.with_version(found.parameters).save(out)
    _found.update(runs=runs, before=found, joint=found)
    return results.identification_json(found)


def _refine(rig: Rig, log: Path) -> None:
    """Add one point's release to the joint estimate."""
    from identification import identify  # noqa: PLC0415
    from studies.runs import load_runs  # noqa: PLC0415

    _found["runs"] += load_runs([log])
    _found["joint"] = identify(_found["runs"], rig, _tell, earlier=_found["joint"])


def _conclude(rig: Rig, out: Path, report: Path, facts: dict[str, Any]) -> dict[str, Any]:
    """Validate the points with what was identified before them, write joint parameters and report."""
    from rig_cli import results  # noqa: PLC0415
    from rig_cli.reporting import reported  # noqa: PLC0415
    from daq.guided_tests.test_inputs import possible_tests  # noqa: PLC0415
    from studies.runs import keep_verdicts, validated  # noqa: PLC0415

    runs, before, joint = _found["runs"], _found["before"], _found["joint"]
    points = {test.removeprefix("point-") for test in possible_tests(rig)}
    seen = rig.model_copy(update={"points": {name: known for name, known in rig.points.items() if name in points}})
    validation = validated(runs, seen, before.parameters, _tell)
    keep_verdicts(validation, runs, facts["validated_with"])
    results.with_version(joint.parameters).save(out)
    reported(report, seen, runs, before.parameters, joint, validation, facts=facts)
    losses = {Path(run.source).name: dict(run.losses) for run in runs}
    return {
        **results.identification_json(joint),
        **validation.to_json(),
        "warnings": [*joint.warnings, *validation.warnings],
        "passed": validation.passed if seen.points else None,  # a rig without sensors for a point has no verdict
        "losses": losses,
        "lines": results.parameter_lines(joint.parameters, facts["truth"]),
    }


class Workbench:
    """One worker process; jobs are carried out in the order given."""

    def __init__(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._told: Queue[str] = context.Queue()
        ours, theirs = context.Pipe(duplex=False)
        self._pool = ProcessPoolExecutor(1, context, _begin_work, (ours, self._told))
        self._lifeline = theirs
        self._pool.submit(_warm_up)

    def identify(self, rig: Rig, logs: list[Path], out: Path) -> Future[dict[str, Any]]:
        """Identify from the tests before the points; writes parameters.toml."""
        return self._pool.submit(_identify, rig, logs, out)

    def refine(self, rig: Rig, log: Path) -> Future[None]:
        """Add a point's release to the joint estimate, while the next point is being recorded."""
        return self._pool.submit(_refine, rig, log)

    def conclude(self, rig: Rig, out: Path, report: Path, facts: dict[str, Any]) -> Future[dict[str, Any]]:
        """Validation, joint parameters, report."""
        return self._pool.submit(_conclude, rig, out, report, facts)

    def wait(self, job: Future[_Result], tell: Callable[[str], None]) -> _Result:
        """A job's result; until then what the worker says it is at.

        Args:
            tell: told what is tried, the latest of it.
        """
        while True:
            latest = None
            with contextlib.suppress(queue.Empty):
                while True:
                    latest = self._told.get_nowait()
            if latest is not None:
                tell(latest)
            try:
                return job.result(timeout=_TOLD_EVERY_S)
            except TimeoutError:
                if job.done():
                    raise

    def close(self) -> None:
        """End the worker, whatever it is at: nobody waits for it any more."""
        self._lifeline.close()
        self._pool.shutdown(wait=True, cancel_futures=True)
