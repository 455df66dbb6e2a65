"""Texts from outside with bytes that are not UTF-8, counted nouns, hints, and numbers compared in a sentence."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable
from typing import SupportsIndex

_ALL_DIGITS = 17  # significant digits that distinguish any two doubles
_LONE_SURROGATE = re.compile("[\ud800-\udfff]")


def storable(text: str) -> str:
    """Return text that can be stored as UTF-8: each lone surrogate becomes U+FFFD, the replacement character.

    Python represents an invalid byte of a file name or of a command line as a lone surrogate, and JSON can contain one.
    No file, log or network message can. A file is opened by its own name, not by this text.
    """
    return text if text.isascii() else _LONE_SURROGATE.sub("\ufffd", text)


def number_of(count: SupportsIndex | str, one: str, many: str = "", form: str = "") -> str:
    """Return a number with what it counts, for example "1 log" or "3 logs".

    All texts that contain a counted noun are made of it, so that none contains "1 logs".

    Args:
        count: how many, or the text of the number.
        one: the noun for one, also with its verb: "sample was lost".
        many: the same for other numbers; empty: `one` with an s.
        form: format of the number, for example "12,d".
    """
    return f"{count:{form}} {one if str(count) == '1' else many or f'{one}s'}"


def did_you_mean(wanted: str, known: Iterable[str], least: float = 0.4) -> str:
    """Return the hint of a message at the most similar of the known names; empty if none is similar.

    Args:
        least: smallest similarity, 0 … 1.
    """
    near = difflib.get_close_matches(wanted, list(known), 1, least)
    return f"; did you mean {near[0]!r}?" if near else ""


def distinct(value: float, limit: float, digits: int = 2) -> tuple[str, str]:
    """Return two compared numbers as text, with as many digits as show which of them is larger.

    Args:
        value, limit: numbers of the same unit.
        digits: significant digits, if these show it.
    """
    for count in range(digits, _ALL_DIGITS + 1):
        texts = f"{value:.{count}g}", f"{limit:.{count}g}"
        if texts[0] != texts[1]:
            break
    else:
        texts = f"{value:.{digits}g}", f"{limit:.{digits}g}"  # equal numbers
    return texts
