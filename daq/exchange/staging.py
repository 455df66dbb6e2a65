"""Files that get their names only when all of them are whole."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from types import TracebackType

from daq.exchange.errors import ExchangeError


class Staging:
    """Files being written beside their final names; `commit` renames them, leaving the block without it removes them.

    Args:
        force: files of the final names may be there and are replaced.
    """

    def __init__(self, force: bool = False) -> None:
        self._force = force
        self._parts: dict[Path, Path] = {}

    def place(self, final: Path) -> Path:
        """Where to write what will be named `final`; its folder is made.

        Raises:
            ExchangeError: there is such a file and it may not be replaced, or the name is a folder's.
        """
        self._refuse_existing(final)
        final.parent.mkdir(parents=True, exist_ok=True)
        part = final.with_name(f"{final.name}.{os.getpid()}.part")
        self._parts[final] = part
        return part

    def commit(self) -> list[Path]:
        """Give every file its name, on the disk for good.

        Raises:
            ExchangeError: a file of such a name has appeared meanwhile.
            OSError: the disk failed; files renamed until then stay.
        """
        for final, part in self._parts.items():
            self._refuse_existing(final)
            with open(part, "rb+") as file:
                os.fsync(file.fileno())
        for final, part in self._parts.items():
            os.replace(part, final)
        return list(self._parts)

    def _refuse_existing(self, final: Path) -> None:
        if final.name.lower().endswith((".mcap", ".part")):
            raise ExchangeError(f"{final}: expected another ending, this is a log's: no export is written over a log")
        if final.is_dir():
            raise ExchangeError(f"{final}: expected a file's name, this is a folder: name the file in it")
        if final.exists() and not self._force:
            raise ExchangeError(f"{final}: exists already; give another name, or --force to replace it")

    def __enter__(self) -> Staging:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for part in self._parts.values():
            with contextlib.suppress(OSError):
                part.unlink(missing_ok=True)
