"""Opens files recorded elsewhere, whatever their format."""

from __future__ import annotations

from pathlib import Path

from daq.exchange.columns import Recording
from daq.exchange.errors import ExchangeError
from rig_configs.regular_file import need_regular


def open_recording(path: Path) -> Recording:
    """Open a file by its content and its name's ending.

    Raises:
        ExchangeError: no such file, an empty one, or none of csv, parquet, mat and hdf5.
    """
    # imported when needed: a csv need not wait for scipy
    from daq.exchange.csv_recording import CsvRecording  # noqa: PLC0415
    from daq.exchange.matlab_recording import Hdf5Recording, MatRecording  # noqa: PLC0415
    from daq.exchange.parquet_recording import ParquetRecording  # noqa: PLC0415

    try:
        need_regular(path)
        with open(path, "rb") as file:
            start = file.read(1024)
    except OSError as fault:
        raise ExchangeError(f"{path}: cannot be read ({fault.strerror}): check the path") from fault
    if not start:
        raise ExchangeError(f"{path}: expected a recording, the file holds nothing")
    if start.startswith(b"PAR1"):
        return ParquetRecording(path)
    if b"\x89HDF\r\n\x1a\n" in (start[:8], start[512:520]):
        return Hdf5Recording(path)
    if path.suffix.lower() == ".mat":
        return MatRecording(path)
    if path.suffix.lower() in (".parquet", ".h5", ".hdf5"):
        raise ExchangeError(f"{path}: expected what its name says, but the content is not {path.suffix.lower()[1:]}")
    return CsvRecording(path)
