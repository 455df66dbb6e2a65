"""Files that get their names only when all of them are complete."""

from __future__ import annotations

import logging
import os
from pathlib import Path
from types import TracebackType

from daq.exchange.errors import ExchangeError
from rig_basics.ignoring import ignoring

_log = logging.getLogger(__name__)


class Staging:
    """Files written under temporary names; `commit` renames them, leaving the block without `commit` removes them.

    Args:
        force: replace existing files of the final names.
    """

    def __init__(self, force: bool = False) -> None:
        self._force = force
        self._parts: dict[Path, Path] = {}

    def place(self, final: Path) -> Path:
        """Return the temporary path of a file that will be named `final`; its folder is created.

        Raises:
            ExchangeError: the file exists and may not be replaced, or the name is that of a folder.
        """
        self._refuse_existing(final)
        final.parent.mkdir(parents=True, exist_ok=True)
        part = final.with_name(f"{final.name}.{os.getpid()}.part")
        self._parts[final] = part
        return part

    def commit(self) -> list[Path]:
        """Rename every file to its final name, after its data are on the disk.

        Raises:
            ExchangeError: a file of such a name has appeared meanwhile.
            OSError: the disk failed; files renamed before remain.
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
            raise ExchangeError(
                f"{final}: expected another ending, this is the ending of a log: an export never overwrites a log"
            )
        if final.is_dir():
            raise ExchangeError(f"{final}: expected a file's name, this is a folder: name the file in it")
        if final.exists() and not self._force:
            raise ExchangeError(f"{final}: exists already; give another name, or permit its replacement (force)")

    def __enter__(self) -> Staging:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for part in self._parts.values():
            with ignoring(_log, f"removing {part}", OSError):
                part.unlink(missing_ok=True)
