"""Parts that every file format of a map shares: keys of its axes, and replacement of a file in one step."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from analysis.maps.question import MapQuestion
from analysis.maps.records import FORMAT


def keys_of(provenance: Mapping[str, Any]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the keys of x and of y."""
    if provenance.get("format") != FORMAT:
        raise ValueError(f"format {provenance.get('format')!r}, known is {FORMAT!r}")
    question = MapQuestion.of_json(provenance["question"])
    return question.x.keys, question.y.keys


def replaced(path: Path, write: Callable[[Path], None]) -> None:
    """Write under a temporary name in the same folder, then replace the file or store."""
    part = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        write(part)
        if path.is_dir():
            shutil.rmtree(path)
        os.replace(part, path)
    finally:
        if part.is_dir():
            shutil.rmtree(part)
        part.unlink(missing_ok=True)
