"""What the person at the terminal sees: progress and messages on standard error, one JSON object on standard output."""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Mapping
from types import TracebackType
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

STDERR = Console(stderr=True, highlight=False)


def print_json(result: Mapping[str, Any]) -> None:
    """One JSON object; numbers that are not finite become null."""
    print(json.dumps(_plain(result)), flush=True)


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if hasattr(value, "item"):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


class StepProgress:
    """Progress through named steps: a live bar on a terminal, a line a step where there is none.

    Args:
        steps: names with their usual durations, s; they weigh the bar.
    """

    def __init__(self, steps: Mapping[str, float]) -> None:
        self._weights = dict(steps)
        self._total = sum(steps.values())
        self._done = 0.0
        self._current = 0.0
        self._live = STDERR.is_terminal
        self._started = time.monotonic()
        self._bar = Progress(
            SpinnerColumn(), TextColumn("{task.description}"), BarColumn(bar_width=24), TimeElapsedColumn(),
            console=STDERR, disable=not self._live, transient=True,
        )  # fmt: skip
        self._task = self._bar.add_task("starting", total=self._total)

    def __enter__(self) -> StepProgress:
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()

    def step(self, name: str) -> None:
        """The next step begins."""
        self._done += self._current
        self._current = self._weights.get(name, 0.0)
        self._bar.update(self._task, completed=self._done, description=name)
        if not self._live:
            STDERR.print(f"[{time.monotonic() - self._started:5.1f} s] {name}")

    def tell(self, text: str, share: float | None = None) -> None:
        """What the step is doing."""
        done = self._done + self._current * (share or 0.0)
        self._bar.update(self._task, completed=done, description=text[:90])

    def say(self, text: str) -> None:
        """A line that stays."""
        STDERR.print(text)


def say(text: str) -> None:
    """A line on standard error."""
    print(text, file=sys.stderr, flush=True)
