"""Opening of recordings of other programs, in any supported format."""

from __future__ import annotations

from pathlib import Path

from daq.exchange.columns import ColumnFile
from daq.exchange.csv_recording import CsvRecording
from daq.exchange.errors import ExchangeError
from daq.exchange.matlab_recording import Hdf5Recording, MatRecording
from daq.exchange.parquet_recording import ParquetRecording
from daq.mcap.writer import MAGIC
from rig_configs.regular_file import need_regular


def open_recording(path: Path, decimal: str | None = None) -> ColumnFile:
    """Open a file according to its content and the ending of its name.

    Args:
        path: the file.
        decimal: decimal sign of a text file, "." or ","; None: it is found.

    Raises:
        ExchangeError: the file does not exist, is empty, or is not csv, parquet, mat or hdf5.
    """
    try:
        need_regular(path)
        with open(path, "rb") as file:
            start = file.read(1024)
    except OSError as fault:
        raise ExchangeError(f"{path}: cannot be read ({fault.strerror}): check the path") from fault
    if not start:
        raise ExchangeError(f"{path}: expected a recording, the file is empty")
    if start.startswith(MAGIC):
        raise ExchangeError(
            f"{path}: expected csv, parquet, mat or hdf5, this is a log already (MCAP); if another program wrote it, "
            "save its topics as one of these first"
        )
    if start.startswith(b"PAR1"):
        return ParquetRecording(path)
    if b"\x89HDF\r\n\x1a\n" in (start[:8], start[512:520]):
        return Hdf5Recording(path)
    if path.suffix.lower() == ".mat":
        return MatRecording(path)
    if path.suffix.lower() in (".parquet", ".h5", ".hdf5"):
        raise ExchangeError(f"{path}: expected {path.suffix.lower()[1:]} as in its name, got another content")
    return CsvRecording(path, decimal)
