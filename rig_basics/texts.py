"""Texts from outside: names of files, command lines and notes can contain bytes that are not UTF-8."""

from __future__ import annotations

import re

_LONE_SURROGATE = re.compile("[\ud800-\udfff]")


def storable(text: str) -> str:
    """Return text that can be stored as UTF-8: each lone surrogate becomes U+FFFD, the replacement character.

    Python represents an invalid byte of a file name or of a command line as a lone surrogate, and JSON can contain one.
    No file, log or network message can. A file is opened by its own name, not by this text.
    """
    return text if text.isascii() else _LONE_SURROGATE.sub("\ufffd", text)
