"""Finished tiles on disk: one file each, complete or absent, named by the digest of the question."""

from __future__ import annotations

import contextlib
import hashlib
import io
import logging
import os
import zipfile
from collections.abc import Generator
from pathlib import Path

import numpy as np

from rig_basics.ignoring import ignoring
from studies.errors import FolderFault
from studies.study import Answer, Study

_SEAL_DIGITS = 64  # hexadecimal digits of a SHA-256
_log = logging.getLogger(__name__)


def packed(answer: Answer) -> bytes:
    """Return a tile's arrays as the bytes of an .npz file; equal arrays yield equal bytes.

    The archive's comment is the SHA-256 of everything before it, so that all damage is found, also in its directory.
    """
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, values in answer.items():
            content = io.BytesIO()
            np.lib.format.write_array(content, np.asanyarray(values), allow_pickle=False)
            archive.writestr(zipfile.ZipInfo(f"{name}.npy"), content.getvalue(), zipfile.ZIP_DEFLATED)
    whole = stream.getvalue()  # it ends with the length of its comment, 0
    return whole[:-2] + _SEAL_DIGITS.to_bytes(2, "little") + hashlib.sha256(whole).hexdigest().encode()


def _need_whole(content: bytes) -> None:
    """Check that a file's content is as written.

    Raises:
        ValueError: the checksum differs.
    """
    whole = content[: -_SEAL_DIGITS - 2] + b"\0\0"
    if hashlib.sha256(whole).hexdigest().encode() != content[-_SEAL_DIGITS:]:
        raise ValueError("its checksum differs")


class TileFolder:
    """A folder with the finished tiles of one study, or of several.

    Args:
        path: folder; created if missing.
        study: study of the tiles.
    Raises:
        FolderFault: the folder cannot be created or written to.
    """

    def __init__(self, path: Path, study: Study) -> None:
        self.path: Path = path
        self.study: Study = study
        with self._faults():
            path.mkdir(parents=True, exist_ok=True)
            self._write(f"{study.digest}.json", study.text.encode())

    def finished(self) -> set[int]:
        """Return the numbers of the finished tiles."""
        with self._faults():
            there = frozenset(os.listdir(self.path))
        return {tile for tile in range(self.study.tiles) if self._name(tile) in there}

    def keep(self, tile: int, content: bytes) -> None:
        """Write a tile's file.

        Raises:
            FolderFault: the disk is full or not available.
        """
        with self._faults():
            self._write(self._name(tile), content)

    def read(self, tile: int) -> Answer:
        """Return a finished tile's arrays.

        Raises:
            FolderFault: the file is missing or damaged; the text contains what to do.
        """
        path = self.path / self._name(tile)
        try:
            content = path.read_bytes()
            _need_whole(content)
            with zipfile.ZipFile(io.BytesIO(content)) as archive:
                return {
                    name.removesuffix(".npy"): np.lib.format.read_array(
                        io.BytesIO(archive.read(name)), allow_pickle=False
                    )
                    for name in archive.namelist()
                }
        except (OSError, ValueError, zipfile.BadZipFile) as fault:
            raise FolderFault(
                f"{path}: expected a finished tile, it cannot be read ({fault}); delete it and give the same command "
                "again: only this tile is computed again"
            ) from fault

    def remove(self) -> None:
        """Remove the tiles, and the folder if it is empty then."""
        with self._faults():
            for tile in self.finished():
                (self.path / self._name(tile)).unlink(missing_ok=True)
            (self.path / f"{self.study.digest}.json").unlink(missing_ok=True)
            with contextlib.suppress(OSError):  # usual: other files are in the folder
                self.path.rmdir()

    def _name(self, tile: int) -> str:
        return f"{self.study.name_of(tile)}.npz"

    def _write(self, name: str, content: bytes) -> None:
        part = self.path / f".{name}.{os.getpid()}.part"
        try:
            with part.open("wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            os.replace(part, self.path / name)
        except BaseException:
            with ignoring(_log, f"removing {part}", OSError):
                part.unlink(missing_ok=True)
            raise

    @contextlib.contextmanager
    def _faults(self) -> Generator[None]:
        try:
            yield
        except OSError as fault:
            raise FolderFault(
                f"{self.path}: a finished tile cannot be kept ({fault.strerror or fault}); make room or choose another "
                "folder, and give the same command again: finished tiles are not computed again"
            ) from fault
