"""Output of commands: progress and messages on standard error, results or one JSON object on standard output."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from types import TracebackType
from typing import Any, Self, cast
from unicodedata import category

from rich.console import Console, RenderableType
from rich.live import Live
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.text import Text

from dynamics.compiled_code import load_compiler
from rig_basics.texts import number_of
from rig_cli import answer

_COMPILING_EVERY_S = 10.0  # between two lines about the functions that are compiled
_CONTROL_CATEGORIES = frozenset(("Cc", "Cf", "Cs", "Cn", "Zl", "Zp"))  # control, format, surrogate, none, line ends


class _Stderr(Console):
    """A console that prints text literally: no markup, no emoji, no control characters."""

    def __init__(self) -> None:
        super().__init__(stderr=True, highlight=False, markup=False, emoji=False)

    def print(self, *objects: Any, **how: Any) -> None:
        super().print(*(harmless(each) if isinstance(each, str) else each for each in objects), **how)


def harmless(text: str) -> str:
    """Return text without characters that move the cursor, change colours or the writing direction; lines are kept.

    Names and notes in files and devices are arbitrary text, and a terminal interprets control characters in it.
    """
    if text.isascii() and text.isprintable():
        return text
    return "".join("\ufffd" if category(each) in _CONTROL_CATEGORIES and each not in "\n\t" else each for each in text)


STDERR = _Stderr()


def print_json(result: Mapping[str, Any]) -> None:
    """Print one JSON object; numbers that are not finite become null."""
    answer.give(plain(result))


def plain(value: Any) -> Any:
    """Return a value that JSON can represent: numpy scalars as Python numbers, numbers that are not finite as None."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in cast("Mapping[object, object]", value).items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in cast("Sequence[object]", value)]
    if hasattr(value, "item"):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


class StepProgress:
    """Progress through named steps: a bar on a terminal, otherwise one line a step.

    Args:
        steps: names with their usual durations, s, which are the weights of the bar.
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
        """Start the next step."""
        self._done += self._current
        self._current = self._weights.get(name, 0.0)
        self._bar.update(self._task, completed=self._done, description=harmless(name))
        if not self._live:
            STDERR.print(f"[{time.monotonic() - self._started:5.1f} s] {name}")

    def update(self, text: str, share: float | None = None) -> None:
        """Show what the step is doing, and its completed share, 0 … 1."""
        done = self._done + self._current * (share or 0.0)
        self._bar.update(self._task, completed=done, description=harmless(text[:90]))

    def notify(self, text: str) -> None:
        """Print a permanent line."""
        STDERR.print(text)


class LiveTable:
    """Base of contexts that show progress: updated in place on a terminal, otherwise as lines.

    Args:
        page: content of the terminal, called four times a second; None if the subclass updates it itself.
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


def notify(text: str) -> None:
    """Print a line on standard error."""
    print(harmless(text), file=sys.stderr, flush=True)


def show(text: str) -> None:
    """Print a line of the result on standard output."""
    print(harmless(text))


@contextmanager
def wait_for_compilation(what: str) -> Generator[None]:
    """Report compilation, which happens once on each machine, while the context waits for it."""
    from numba.core import event  # numba takes a third of a second to import

    load_compiler()

    class FirstCompilation(event.Listener):
        def __init__(self) -> None:
            self.seconds, self.depth, self.started = 0.0, 0, 0.0
            self.functions, self.shown_s = 0, 0.0

        def on_start(self, event: Any) -> None:
            if self.depth == 0:
                self.started = time.monotonic()
                if self.seconds == 0:
                    self.shown_s = self.started
                    notify(
                        f"compiling {what} code, once after an installation: ten seconds, minutes on a busy machine …"
                    )
            self.depth += 1

        def on_end(self, event: Any) -> None:
            self.depth -= 1
            self.functions += 1
            now = time.monotonic()
            if now - self.shown_s > _COMPILING_EVERY_S:
                self.shown_s = now
                notify(f"compiling: {number_of(self.functions, 'function')} so far …")
            if self.depth == 0:
                self.seconds += now - self.started

    listener = FirstCompilation()
    # numba has no types
    install: Callable[[str, event.Listener], AbstractContextManager[None]] = vars(event)["install_listener"]
    with install("numba:compile", listener):
        yield
    if listener.seconds > 0:
        notify(f"compiled in {listener.seconds:.0f} s; the next run of this command starts without compiling")


@contextmanager
def status_line(first: str) -> Generator[Callable[[str], None]]:
    """Yield a function that shows the current activity: one updated line on a terminal, otherwise a line each."""
    if not STDERR.is_terminal:
        notify(first)
        yield notify
        return
    with STDERR.status(Text(harmless(first))) as status:
        yield lambda text: status.update(Text(harmless(text)))
