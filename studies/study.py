# pyright: strict
"""What is asked of a study, and the digest by which its tiles are known."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from studies.errors import StudyInputError

Answer = dict[str, NDArray[Any]]
"""What one tile found: arrays by name."""

_KINDS = {
    "basins": "studies.basins",
    "campaigns": "studies.campaigns",
    "map": "studies.maps",
    "archive": "studies.archive",
    "coexistence": "studies.coexistence",
    "releases": "studies.releases",
}
_SOURCES = ("dynamics", "uncertainty", "rig_configs", "daq", "identification", "analysis", "studies")


class Kind(Protocol):
    """A kind of study: a module's `KIND`.

    A tile's answer follows from the question and the tile's number alone: the same bytes on any machine of one kind,
    in any order, however many threads there are.
    """

    uses_threads: bool
    """Whether its tiles run beside each other in the threads of one process."""

    def tiles(self, text: str) -> int:
        """How many there are."""
        ...

    def part(self, text: str, tile: int) -> str | None:
        """All of the question that decides one tile's answer: other questions with this part have the tile in common.

        None: the whole question, of which the tile has its number.
        """
        ...

    def warm_up(self, text: str) -> None:
        """Import and compile what a tile needs."""
        ...

    def answer(self, text: str, tile: int, threads: int) -> Answer:
        """Work one tile out.

        Args:
            text: the question as JSON.
            tile: 0 … tiles − 1.
            threads: that it may use.
        """
        ...


def kind_named(name: str) -> Kind:
    """A kind of study by its name.

    Raises:
        StudyInputError: there is no such kind.
    """
    if name not in _KINDS:
        raise StudyInputError(f"no kind of study {name!r}; known: {', '.join(sorted(_KINDS))}")
    return import_module(_KINDS[name]).KIND


@dataclass(frozen=True)
class Study:
    """What is asked.

    Attributes:
        kind: name of a kind of study.
        text: the question as JSON, all that decides the answer but the software.
        software: digest of the sources that are to answer it.
    """

    kind: str
    text: str
    software: str

    @classmethod
    def of(cls, kind: str, question: Mapping[str, Any]) -> Study:
        """A study by the sources that run here.

        Args:
            question: what JSON can hold; numbers finite.
        """
        return cls(kind, cls.question(question), software_digest())

    @classmethod
    def question(cls, question: Mapping[str, Any]) -> str:
        """A question as the one text that stands for it."""
        return json.dumps(question, sort_keys=True, allow_nan=False, ensure_ascii=False, separators=(",", ":"))

    @cached_property
    def digest(self) -> str:
        """Twenty hexadecimal digits that change with anything that could change an answer."""
        return self._digest_of(self.text)

    def name_of(self, tile: int) -> str:
        """A tile's name: with the same name the same answer."""
        part = kind_named(self.kind).part(self.text, tile)
        return f"{self.digest}-{tile:06d}" if part is None else self._digest_of(part)

    def _digest_of(self, question: str) -> str:
        whole = "\n".join([self.kind, self.software, np.__version__, question])
        return hashlib.sha256(whole.encode()).hexdigest()[:20]

    @cached_property
    def tiles(self) -> int:
        """How many parts it has."""
        return kind_named(self.kind).tiles(self.text)


@lru_cache(maxsize=1)
def software_digest() -> str:
    """Sixteen hexadecimal digits that change with any source a tile's answer can depend on."""
    root, found = Path(__file__).parents[1], hashlib.sha256()
    for package in _SOURCES:
        for path in sorted((root / package).rglob("*.py")):
            found.update(path.relative_to(root).as_posix().encode())
            found.update(path.read_bytes())
    return found.hexdigest()[:16]
