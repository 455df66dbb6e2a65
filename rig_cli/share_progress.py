"""Progress of work with a known completed share: rate and time left, updated in place on a terminal.

The time left is an extrapolation. It is shown only if two estimates agree within 25 %: by the mean rate m since the
start, and by the rate r in the second half of the time since then. The first half then has the rate 2 m - r, so that
0.8 m <= r <= 1.33 m: the halves differ by a factor of two at most. A first step that also compiles, and work that
becomes slower and slower, give no time until the rate is steady.
"""

from __future__ import annotations

import bisect
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager

from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from rig_cli import console

_EVERY_S = 10.0
_AGREEMENT = 0.25  # relative difference of two estimates of the time left


@contextmanager
def share_progress(
    text: str, count: float | None = None, unit: str = "", before: float = 0.0
) -> Generator[Callable[[float], None]]:
    """Yield a function that shows the completed share, 0 … 1: a bar on a terminal, else a line every ten seconds.

    Ctrl-C prints the share that was completed.

    Args:
        text: the work.
        count, unit: total amount of work and its unit; None: the rate is shown in percent.
        before: share that is completed at the start.
    """
    live = console.STDERR.is_terminal
    bar = Progress(
        SpinnerColumn(),
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=32),
        TextColumn("{task.percentage:3.0f} %"),
        TimeElapsedColumn(),
        TextColumn("{task.fields[pace]}", markup=False),
        console=console.STDERR,
        disable=not live,
        transient=True,
    )
    began = last = time.monotonic()
    reached = 0.0
    pace = Pace(count, unit, before)

    def progress(share: float) -> None:
        nonlocal last, reached
        reached, now = share, time.monotonic()
        words = pace.words(share, now - began)
        if live:
            bar.update(task, completed=share, pace=words)
        elif now - last > _EVERY_S:
            last = now
            console.notify(f"{text}: {100 * share:.0f} %{_after_comma(words)}")

    try:
        with bar:
            task = bar.add_task(console.harmless(text), total=1.0, pace="")
            yield progress
    except KeyboardInterrupt:
        console.notify(f"stopped: {text}, {100 * reached:.0f} % done")
        raise


class Pace:
    """Rate of some work, and the time left as soon as two estimates of it agree.

    Args:
        count, unit: total amount of work and its unit; None: the rate is shown in percent.
        before: share that is completed at the start.
    """

    def __init__(self, count: float | None, unit: str, before: float = 0.0) -> None:
        self._count, self._unit = count, unit
        self._times_s, self._shares = [0.0], [before]

    def words(self, share: float, elapsed_s: float) -> str:
        """Return the mean rate since the start, and the time left if it is certain; empty before any progress.

        Args:
            share: completed share, 0 … 1.
            elapsed_s: time since the start, s.
        """
        done = share - self._shares[0]
        if not 0 < done <= 1 - self._shares[0] or elapsed_s <= 0:
            return ""
        rate = done / elapsed_s
        recent = self._recent_rate(share, elapsed_s)
        words = f"{_short(100 * rate)} %/s" if self._count is None else f"{_short(self._count * rate)} {self._unit}/s"
        if share == 1 or recent is None or not abs(rate / recent - 1) <= _AGREEMENT:
            return words
        return f"{words}, {_duration((1 - share) / rate)} left"

    def _recent_rate(self, share: float, elapsed_s: float) -> float | None:
        """Note a share; return the rate in the second half of the time since the start, 1/s.

        None at the first share, in which the halves cannot be distinguished, and without progress in the second half.
        """
        times, shares = self._times_s, self._shares
        half = 0.5 * elapsed_s
        found = None
        if len(times) > 1:
            after = bisect.bisect_right(times, half)
            end = (times[after], shares[after]) if after < len(times) else (elapsed_s, share)
            begin = times[after - 1], shares[after - 1]
            reached = begin[1] + (end[1] - begin[1]) * (half - begin[0]) / (end[0] - begin[0])
            found = (share - reached) / half if share > reached else None
        if (
            share > shares[-1] and elapsed_s - times[-1] > 0.01 * elapsed_s
        ):  # a few hundred, however long the work takes
            times.append(elapsed_s)
            shares.append(share)
        return found


def _duration(seconds: float) -> str:
    if seconds < 60:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02d} min"


def _short(number: float) -> str:
    """Return three digits, with a space between thousands."""
    return f"{number:.3g}" if number < 1000 else f"{float(f'{number:.3g}'):,.0f}".replace(",", "\u202f")


def _after_comma(words: str) -> str:
    return f", {words}" if words else ""
