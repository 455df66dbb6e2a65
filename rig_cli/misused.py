# pyright: strict
"""What is said of a command line that cannot be parsed: cyclopts' own words, and which option a letter stands for."""

from __future__ import annotations

import difflib
from itertools import chain

from cyclopts import CycloptsError, CycloptsPanel, UnknownOptionError

_LETTER = 2  # signs of an option of one letter


def error_words(error: CycloptsError) -> str:
    """The error as a sentence, with what may have been meant.

    Cyclopts finds options that are spelt alike; one letter is like none of them, so those that begin with it are named.
    """
    words = str(error)
    if not isinstance(error, UnknownOptionError):
        return words
    given = (error.token.keyword or error.token.value).partition("=")[0]
    if len(given) != _LETTER or not given.startswith("-") or "Did you mean" in words:
        return words
    there = chain.from_iterable(each.names for each in error.argument_collection if each.parse)
    likely = [name for name in dict.fromkeys(there) if name.startswith("-" + given)]
    likely.sort(key=lambda name: -difflib.SequenceMatcher(None, name, given).ratio())
    return f"{words} Did you mean {' or '.join(likely)}?" if likely else words


def error_panel(error: CycloptsError) -> object:
    """The same as cyclopts frames it in a terminal."""
    return CycloptsPanel(error_words(error))
