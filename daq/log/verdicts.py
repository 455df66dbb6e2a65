"""What a validation said of a log, kept beside it as NAME.mcap.verdict.json: a finished log is never written again.

The verdict names the log by its digest, so that one of another file, or of this file before it was changed, is known
as such (`Verdict.is_of`).
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import secrets
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from daq.errors import LogError, RecordingError
from rig_configs.regular_file import need_regular

SUFFIX = ".verdict.json"
_MOST_BYTES = 2**20  # a verdict is a few lines; a file that claims more is none
_BLOCK_BYTES = 2**20


class Verdict(BaseModel):
    """One validation's verdict on one log.

    Attributes:
        verdict: "pass", "fail", "not settled", "not locked" or "not enough data".
        state: what was measured: "I", "II", "III", "slipping", "not settled"; empty where there is none.
        why: the verdict's reason in one sentence.
        point: the point it was held against; empty where there is none.
        parameters: which parameters the model had, for example "parameters.toml sha256:1a2b3c4d".
        software: version that judged.
        judged_at: when, ISO 8601.
        digest: "sha256:" and 64 hexadecimal digits, of the whole log.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    verdict: Annotated[str, Field(min_length=1)]
    state: str = ""
    why: str = ""
    point: str = ""
    parameters: str = ""
    software: str = ""
    judged_at: str
    digest: Annotated[str, Field(pattern=r"^sha256:[0-9a-f]{64}$")]

    def is_of(self, digest: str) -> bool:
        """Whether it was said of the log with this digest."""
        return self.digest == digest


def verdict_path(log_path: Path) -> Path:
    """Where the verdict on a log is kept."""
    return log_path.with_name(log_path.name + SUFFIX)


def keep_verdict(log_path: str | Path, verdict: Verdict) -> Path:
    """Keep a verdict beside its log, in place of an earlier one; readers see the old one or the new one, never half.

    Returns:
        The file written.

    Raises:
        RecordingError: it cannot be written there.
    """
    path = verdict_path(Path(log_path))
    written = path.with_name(f"{path.name}.{secrets.token_hex(4)}.new")
    try:
        try:
            with open(written, "xb") as file:
                file.write(verdict.model_dump_json(indent=2).encode() + b"\n")
                file.flush()
                os.fsync(file.fileno())
            os.replace(written, path)
        except BaseException:
            with contextlib.suppress(OSError):
                written.unlink()
            raise
    except OSError as fault:
        raise RecordingError(
            f"{path}: the verdict cannot be kept beside its log ({fault.strerror}). Make the folder writable, or copy "
            "the log to one that is"
        ) from fault
    return path


def verdict_of(log_path: str | Path) -> Verdict | None:
    """The verdict kept beside a log, None when there is none; hold its `digest` against the log's (`digest_of`).

    Raises:
        LogError: a file of that name is there and is no verdict.
    """
    path = verdict_path(Path(log_path))
    try:
        need_regular(path)
        with open(path, "rb") as file:
            text = file.read(_MOST_BYTES + 1)
    except FileNotFoundError:
        return None
    except OSError as fault:
        raise LogError(f"{path}: expected a verdict, cannot read it ({fault.strerror})") from fault
    if len(text) > _MOST_BYTES:
        raise LogError(f"{path}: expected a verdict of a few lines, got more than {_MOST_BYTES} bytes; remove it")
    try:
        return Verdict.model_validate_json(text)
    except ValidationError as fault:
        first = fault.errors()[0]
        where = ".".join(map(str, first["loc"])) or "the file"
        raise LogError(
            f"{path}: expected a verdict as `rig validate` keeps it, got: {where}: {first['msg']}; "
            "validate the log again, or remove the file"
        ) from fault


def digest_of(path: str | Path, progress: Callable[[float], None] | None = None) -> str:
    """Digest of a whole file: "sha256:" and 64 hexadecimal digits; `progress` is told the share done, 0 … 1.

    Raises:
        LogError: it cannot be read.
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
