"""What the person at the terminal sees: progress and messages on standard error, one JSON object on standard output."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from types import TracebackType
from typing import Any, Self
from unicodedata import category

from rich.console import Console, RenderableType
from rich.live import Live
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.text import Text

from rig_cli import answer
from dynamics.compiled_code import load_compiler

_OBEYED = frozenset(("Cc", "Cf", "Cs", "Cn", "Zl", "Zp"))  # control, format, half characters, none, line ends


class _Stderr(Console):
    """A console on which text is text: brackets and colons mean themselves, and nothing in it moves the cursor."""

    def __init__(self) -> None:
        super().__init__(stderr=True, highlight=False, markup=False, emoji=False)

    def print(self, *objects: Any, **how: Any) -> None:
        super().print(*(harmless(each) if isinstance(each, str) else each for each in objects), **how)


def harmless(text: str) -> str:
    """Text of any origin, in lines, without what would move the cursor, change colours or turn its direction.

    Files and devices are named and annotated by anybody; a terminal obeys whatever it is shown.
    """
    if text.isascii() and text.isprintable():
        return text
    return "".join("\ufffd" if category(each) in _OBEYED and each not in "\n\t" else each for each in text)


STDERR = _Stderr()


def print_json(result: Mapping[str, Any]) -> None:
    """One JSON object; numbers that are not finite become null."""
    answer.give(plain(result))


def plain(value: Any) -> Any:
    """The value as JSON takes it: numpy numbers as plain ones, what is not finite as null."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
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
            SpinnerColumn(),
            TextColumn("{task.description}", markup=False),
            BarColumn(bar_width=24),
            TimeElapsedColumn(),
            console=STDERR,
            disable=not self._live,
            transient=True,
        )
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
        self._bar.update(self._task, completed=self._done, description=harmless(name))
        if not self._live:
            STDERR.print(f"[{time.monotonic() - self._started:5.1f} s] {name}")

    def tell(self, text: str, share: float | None = None) -> None:
        """What the step is doing."""
        done = self._done + self._current * (share or 0.0)
        self._bar.update(self._task, completed=done, description=harmless(text[:90]))

    def say(self, text: str) -> None:
        """A line that stays."""
        STDERR.print(text)


class LiveTable:
    """A context in which a subclass shows how work goes: on a terminal in place, elsewhere by lines.

    Args:
        page: what the terminal shows, asked four times a second; None: the subclass updates it itself.
    """

    def __init__(self, page: Callable[[], RenderableType] | None = None) -> None:
        self._live: Live | None = None
        if STDERR.is_terminal:
            self._live = Live(console=STDERR, transient=True, auto_refresh=page is not None, get_renderable=page)

    def __enter__(self) -> Self:
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live is not None:
            self._live.stop()


def say(text: str) -> None:
    """A line on standard error."""
    print(harmless(text), file=sys.stderr, flush=True)


def show(text: str) -> None:
    """A line of the result, on standard output."""
    print(harmless(text))


@contextmanager
def wait_for_compilation(what: str) -> Iterator[None]:
    """Say what is being waited for when code is compiled for this machine, which happens once."""
    from numba.core import event  # noqa: PLC0415 (numba takes a third of a second to import)

    load_compiler()

    class FirstCompilation(event.Listener):
        def __init__(self) -> None:
            self.seconds, self.depth, self.started = 0.0, 0, 0.0

        def on_start(self, event: Any) -> None:
            if self.depth == 0:
                self.started = time.monotonic()
                if self.seconds == 0:
                    say(f"compiling {what} code, not yet there on this machine: ten seconds, a minute on a slow one …")
            self.depth += 1

        def on_end(self, event: Any) -> None:
            self.depth -= 1
            if self.depth == 0:
                self.seconds += time.monotonic() - self.started

    listener = FirstCompilation()
    with event.install_listener("numba:compile", listener):
        yield
    if listener.seconds > 0:
        say(f"compiled in {listener.seconds:.0f} s; the next run finds it ready")


@contextmanager
def step_told(first: str) -> Iterator[Callable[[str], None]]:
    """On a terminal one line with what is being worked on, the latest that was told; elsewhere a line each."""
    if not STDERR.is_terminal:
        say(first)
        yield say
        return
    with STDERR.status(Text(harmless(first))) as status:
        yield lambda text: status.update(Text(harmless(text)))
