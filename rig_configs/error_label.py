"""Names of errors that several tests or predictions share, such as a laser's gain or the rate of a device's clock.

Errors with equal labels are one error. Files, tables and pages contain the text of a label, code uses its fields.
`ErrorLabel.read` is the only place that takes such a text apart.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal

Kind = Literal["axis angle", "clock", "friction", "gain", "known", "other", "slow roll", "suspension"]

_KINDS: tuple[Kind, ...] = ("axis angle", "clock", "friction", "gain", "known", "slow roll", "suspension")
_IN_LOG = re.compile(r"(\S.*?) in (.+)", re.DOTALL)


@dataclass(frozen=True, order=True)
class ErrorLabel:
    """Name of one error.

    Labels with the same text are equal: fields that a file would not return in the same way are moved. The name of a
    clock ends before the first " in ".

    Attributes:
        kind: cause of the error. "known" is a number of the rig file or an instrument, "friction" a quantity that all
            pendulum tests find together, "other" a text of no known kind, for example of another program.
        of: name of the laser's axis, clock, number, instrument or term, or number of an independent part; "" if the
            kind has a single error; the whole text for "other".
        log: names of the logs of the part of a clock's error that belongs to these logs alone, else "".
    """

    kind: Kind
    of: str = ""
    log: str = ""

    def __post_init__(self) -> None:
        for name, value in zip(("kind", "of", "log"), _fields(self.text), strict=True):
            object.__setattr__(self, name, value)

    @property
    def text(self) -> str:
        """Text in files, tables and pages: "gain x", "clock laser_x in 04-run-up.mcap"."""
        named = self.of if self.kind == "other" else f"{self.kind} {self.of}" if self.of or self.log else self.kind
        return f"{named} in {self.log}" if self.log else named

    @classmethod
    def read(cls, text: str) -> ErrorLabel:
        """Return the label with a text. Every text is valid; one that begins with no known kind has the kind "other".

        Args:
            text: text as in a parameters.toml.
        """
        return cls(*_fields(text))


def _fields(text: str) -> tuple[Kind, str, str]:
    """Return kind, name and logs in a text."""
    for kind in _KINDS:
        start, of = text[: len(kind) + 1], text[len(kind) + 1 :]
        if text == kind or (start == f"{kind} " and of):
            found = _IN_LOG.fullmatch(of) if kind == "clock" else None
            return (kind, of, "") if found is None else (kind, found[1], found[2])
    return "other", text, ""
