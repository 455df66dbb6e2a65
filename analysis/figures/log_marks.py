"""Events of a log in its overview: losses shaded, locks, faults and restarts as dotted lines."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

import numpy as np
from matplotlib import font_manager
from matplotlib.axes import Axes
from numpy.typing import NDArray

from analysis.figures.style import GREY
from daq.items import LOSS_KINDS
from daq.log.content import seconds

_LETTER_WIDTH = 0.0082  # of one letter of size _SIZE, relative to the axes' width
_SIZE = 7.5
_SAME_MARK_SHARE = 0.004  # of the displayed time: events within it have one mark
_MAX_LETTERS = 28
_TROUBLE = "#CC3311"


class Marks:
    """Losses and events over the figure's time, s, in memory bounded by the figure's columns.

    Args:
        span: first and last instant of the figure, s.
        columns: number of columns for the shading of losses.
    """

    def __init__(self, span: tuple[float, float], columns: int) -> None:
        self._start, self._length, self._columns = span[0], span[1] - span[0], columns
        self._lost: dict[str, NDArray[np.bool_]] = {}
        self._missing = np.zeros(columns, bool)
        self._happened: dict[int, dict[str, bool]] = {}  # by position: texts, and whether they are faults

    @property
    def has_losses(self) -> bool:
        """Whether anything is shaded."""
        return bool(self._missing.any() or any(lost.any() for lost in self._lost.values()))

    def add(self, event: Mapping[str, Any], time: float) -> None:
        """Add an event of the log; events without information on the run (replies, status …) are ignored."""
        kind, device, text = event.get("kind"), str(event.get("device", "")), str(event.get("text", ""))
        if kind in LOSS_KINDS:
            lost = self._lost.setdefault(device, np.zeros(self._columns, bool))
            self._shade(lost, time - seconds(event, "span_s"), time)
        elif kind == "silence":
            if "span_s" in event:
                lost = self._lost.setdefault(str(event.get("of", device)), np.zeros(self._columns, bool))
                self._shade(lost, time - seconds(event, "span_s"), time)
        elif kind == "lock" and event.get("state") in ("locked", "released", "fault"):
            self._mark(time, text.replace("pendulum ", ""), event["state"] == "fault")
        elif kind in ("fault", "restart", "emergency", "disk", "blind", "encoder", "stop", "network"):
            words = text if kind in ("emergency", "disk", "blind", "encoder", "stop") else f"{device} {kind}"
            self._mark(time, words, True)

    def add_missing(self, start: float, end: float | None) -> None:
        """Shade a time that is missing in the file; mark the position of the cut if the time has no end."""
        if end is None:
            self._mark(start, "log cut here", True)
        else:
            self._shade(self._missing, start, end)

    def _shade(self, lost: NDArray[np.bool_], start: float, end: float) -> None:
        first, last = (self._columns * (np.array([start, end]) - self._start) / self._length).clip(0, self._columns - 1)
        lost[int(first) : int(last) + 1] = True

    def _mark(self, time: float, text: str, trouble: bool) -> None:
        place = int(np.clip((time - self._start) / self._length, 0, 1) / _SAME_MARK_SHARE)
        self._happened.setdefault(place, {})[drawable(text[:_MAX_LETTERS])] = trouble

    def shade(self, axes: Axes, device: str | None, colour: str) -> None:
        """Shade losses of a device and of the file; all losses if the device is not known."""
        lost = self._missing.copy()
        for name, columns in self._lost.items():
            if device in (None, name):
                lost |= columns
        edges = np.flatnonzero(np.diff(np.concatenate([[False], lost, [False]]).astype(int)))
        for first, last in edges.reshape(-1, 2) * self._length / self._columns + self._start:
            axes.axvspan(first, last, color=colour, alpha=0.25, lw=0, zorder=2.5)

    def draw(self, grid: list[Axes]) -> None:
        """Draw dotted lines through all axes, with the events' texts above them where there is room."""
        free = 0.0
        for place, texts in sorted(self._happened.items()):
            share = min((place + 0.5) * _SAME_MARK_SHARE, 1.0)
            colour = _TROUBLE if any(texts.values()) else GREY
            for axes in grid:
                axes.axvline(self._start + share * self._length, color=colour, lw=0.8, ls=":")
            words = _joined(list(texts))
            width = len(words) * _LETTER_WIDTH
            rightmost = min(share, 1.0 - width)
            left = max(free, min(share - width / 2, rightmost))
            if left > rightmost:
                continue
            grid[0].annotate(
                words,
                (left, 1.0),
                (0, 3),
                xycoords="axes fraction",
                textcoords="offset points",
                fontsize=_SIZE,
                color=colour,
                parse_math=False,
                annotation_clip=False,
            )
            free = left + width + 2 * _LETTER_WIDTH


def drawable(text: str) -> str:
    """Return a text with "?" for each letter that is missing in the figures' font."""
    fonts = cast("Any", font_manager)  # partly typed
    font = fonts.get_font(fonts.findfont("DejaVu Sans"))
    return "".join(letter if letter.isprintable() and font.get_char_index(ord(letter)) else "?" for letter in text)


def _joined(texts: list[str]) -> str:
    """ "A released", "B released" → "A, B released"."""
    pairs = [text.split(" ", 1) for text in texts]
    if len(texts) > 1 and all(len(pair) == 2 and pair[1] == pairs[0][1] for pair in pairs):
        return f"{', '.join(sorted(pair[0] for pair in pairs))} {pairs[0][1]}"
    return f"{texts[0]} and {len(texts) - 1} more" if len(texts) > 2 else ", ".join(texts)
