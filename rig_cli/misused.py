"""Errors of a command line that cannot be parsed: the text of cyclopts, and which option a letter may stand for."""

from __future__ import annotations

import difflib
from itertools import chain

from cyclopts import CycloptsError, CycloptsPanel, UnknownOptionError

_LETTER = 2  # characters of an option of one letter, with its hyphen


def error_words(error: CycloptsError) -> str:
    """Return the error as a sentence, with the options that may have been meant.

    Cyclopts suggests options of similar spelling. It finds none for one letter: options that begin with it are named.
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
    """Return the error in the frame that cyclopts prints in a terminal."""
    return CycloptsPanel(error_words(error))
