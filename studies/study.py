"""Question of a study, and the digest that identifies its tiles."""

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
"""Result of one tile: arrays by name."""

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

    A tile's answer depends on the question and the tile's number only: the same bytes on all machines of one kind, in
    any order, with any number of threads.
    """

    uses_threads: bool
    """Whether its tiles may run concurrently in the threads of one process."""

    def tiles(self, text: str) -> int:
        """Return the number of tiles."""
        ...

    def part(self, text: str, tile: int) -> str | None:
        """Return the part of the question that determines one tile's answer; tiles with equal parts are shared.

        None: the whole question and the tile's number.
        """
        ...

    def warm_up(self, text: str) -> None:
        """Import and compile the code of a tile."""
        ...

    def answer(self, text: str, tile: int, threads: int) -> Answer:
        """Compute one tile.

        Args:
            text: question as JSON.
            tile: number of the tile, 0 … tiles − 1.
            threads: number of threads that it may use.
        """
        ...


def kind_named(name: str) -> Kind:
    """Return a kind of study by name.

    Raises:
        StudyInputError: the kind does not exist.
    """
    if name not in _KINDS:
        raise StudyInputError(f"no kind of study {name!r}; known: {', '.join(sorted(_KINDS))}")
    return import_module(_KINDS[name]).KIND


@dataclass(frozen=True)
class Study:
    """A question in tiles.

    Attributes:
        kind: name of the kind of study.
        text: question as JSON; it determines the answer together with the software.
        software: digest of the sources.
    """

    kind: str
    text: str
    software: str

    @classmethod
    def of(cls, kind: str, question: Mapping[str, Any]) -> Study:
        """Return a study with the sources of this process.

        Args:
            kind: name of the kind of study.
            question: JSON values with finite numbers.
        """
        return cls(kind, cls.question(question), software_digest())

    @classmethod
    def question(cls, question: Mapping[str, Any]) -> str:
        """Return the canonical text of a question."""
        return json.dumps(question, sort_keys=True, allow_nan=False, separators=(",", ":"))

    @cached_property
    def digest(self) -> str:
        """Twenty hexadecimal digits that depend on everything that could change an answer."""
        return self._digest_of(self.text)

    def name_of(self, tile: int) -> str:
        """Return a tile's name; equal names have equal answers."""
        part = kind_named(self.kind).part(self.text, tile)
        return f"{self.digest}-{tile:06d}" if part is None else self._digest_of(part)

    def _digest_of(self, question: str) -> str:
        whole = "\n".join([self.kind, self.software, np.__version__, question])
        return hashlib.sha256(whole.encode()).hexdigest()[:20]

    @cached_property
    def tiles(self) -> int:
        """Number of tiles."""
        return kind_named(self.kind).tiles(self.text)


@lru_cache(maxsize=1)
def software_digest() -> str:
    """Return sixteen hexadecimal digits that depend on all sources that can change a tile's answer."""
    root, found = Path(__file__).parents[1], hashlib.sha256()
    for package in _SOURCES:
        for path in sorted((root / package).rglob("*.py")):
            found.update(path.relative_to(root).as_posix().encode())
            found.update(path.read_bytes())
    return found.hexdigest()[:16]
