"""Verdict of a validation, stored next to its log as NAME.mcap.verdict.json: a finished log is never written again.

The verdict contains the digest of the log. A verdict on another file, or on this file before it was changed, is
therefore detected (`LoggedVerdict.is_of`).
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, Field, ValidationError

from daq.errors import LogError, RecordingError
from rig_basics.whole_file import write_whole_text
from rig_configs.regular_file import need_regular

SUFFIX = ".verdict.json"
_MOST_BYTES = 2**20  # a verdict is a few lines; a larger file is rejected
_BLOCK_BYTES = 2**20


class LoggedVerdict(BaseModel, extra="forbid", frozen=True):
    """One validation's verdict on one log.

    Attributes:
        verdict: "pass", "fail", "not settled", "not locked" or "not enough data".
        state: measured state: "I", "II", "III", "slipping", "not settled"; may be empty.
        why: reason for the verdict in one sentence.
        point: operating point the log was compared with; empty for other tests.
        parameters: parameters of the model, for example "parameters.toml sha256:1a2b3c4d".
        software: version of the software that validated.
        judged_at: time of the validation, ISO 8601.
        digest: "sha256:" and 64 hexadecimal digits, of the whole log.
    """

    verdict: Annotated[str, Field(min_length=1)]
    state: str = ""
    why: str = ""
    point: str = ""
    parameters: str = ""
    software: str = ""
    judged_at: str
    digest: Annotated[str, Field(pattern=r"^sha256:[0-9a-f]{64}$")]

    def is_of(self, digest: str) -> bool:
        """Return True if the verdict belongs to the log with this digest."""
        return self.digest == digest


def verdict_path(log_path: Path) -> Path:
    """Return the path of the verdict file of a log."""
    return log_path.with_name(log_path.name + SUFFIX)


def without_verdicts(paths: Iterable[Path]) -> tuple[Path, ...]:
    """Return paths of logs without verdict files, which a pattern such as logs/* matches as well."""
    return tuple(path for path in paths if not path.name.endswith(f".mcap{SUFFIX}"))


def keep_verdict(log_path: str | Path, verdict: LoggedVerdict) -> Path:
    """Write the verdict file of a log, replacing an earlier one; readers get the old or the new one, never a part.

    Returns:
        The file written.

    Raises:
        RecordingError: the file cannot be written there.
    """
    path = verdict_path(Path(log_path))
    try:
        write_whole_text(path, verdict.model_dump_json(indent=2) + "\n")
    except OSError as fault:
        raise RecordingError(
            f"{path.parent}: a verdict cannot be written next to its log ({fault.strerror}). Make the folder "
            "writable, or copy the logs to a writable one"
        ) from fault
    return path


def verdict_of(log_path: str | Path) -> LoggedVerdict | None:
    """Return the verdict stored next to a log, or None; compare its `digest` with `digest_of` the log.

    Raises:
        LogError: the verdict file exists and is not a verdict.
    """
    path = verdict_path(Path(log_path))
    try:
        need_regular(path)
        with open(path, "rb") as file:
            text = file.read(_MOST_BYTES + 1)
    except FileNotFoundError:  # usual: a log without a verdict
        return None
    except OSError as fault:
        raise LogError(f"{path}: expected a verdict, cannot read it ({fault.strerror})") from fault
    if len(text) > _MOST_BYTES:
        raise LogError(f"{path}: expected a verdict of a few lines, got more than {_MOST_BYTES} bytes; remove it")
    try:
        return LoggedVerdict.model_validate_json(text)
    except ValidationError as fault:
        first = fault.errors()[0]
        where = ".".join(map(str, first["loc"])) or "the file"
        raise LogError(
            f"{path}: expected a verdict as `rig validate` writes it, got: {where}: {first['msg']}; "
            "validate the log again, or remove the file"
        ) from fault


def digest_of(path: str | Path, progress: Callable[[float], None] | None = None) -> str:
    """Return the digest of a whole file: "sha256:" and 64 hexadecimal digits.

    Args:
        progress: called with the completed share, 0 … 1.

    Raises:
        LogError: the file cannot be read.
    """
    digest = hashlib.sha256()
    done = 0
    try:
        need_regular(path)
        with open(path, "rb") as file:
            size = max(1, os.fstat(file.fileno()).st_size)
            while block := file.read(_BLOCK_BYTES):
                digest.update(block)
                done += len(block)
                if progress is not None:
                    progress(min(1.0, done / size))
    except OSError as fault:
        raise LogError(f"{path}: cannot be read to its end ({fault.strerror})") from fault
    return f"sha256:{digest.hexdigest()}"
