"""The rig file of a running virtual rig: the file that its operator would write for a real rig, with ports."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any, cast

import tomlkit

from rig_basics.whole_file import write_whole_text
from rig_cli.options import check_outputs
from rig_configs import RigFileError, parse_setting
from rig_configs.load import apply_setting, shipped_rigs
from rig_configs.toml_text import read_text

_FIRST_LINE = "# Written by `rig virtual`, which overwrites it."


def need_free(output: Path) -> None:
    """Check that the file may be written.

    Raises:
        RigFileError: the folder does not exist, or a file of that name exists that `rig virtual` has not written.
    """
    check_outputs("--output", output, force=True)
    if output.exists() and not read_text(output).startswith(_FIRST_LINE):
        raise RigFileError(f"--output {output}: a file of this name exists; give another name, or remove the file")


def write_plugged(rig: str, settings: Sequence[str], ports: Mapping[str, str], output: Path) -> None:
    """Write a rig file with settings applied, with these ports and without [virtual].

    Args:
        rig: path or name.
        settings: "key=value" texts; those of [virtual] are left out.
        ports: ports of the devices by name.
        output: the file.

    Raises:
        OSError: it cannot be written.
    """
    document: Any = tomlkit.parse(_text(rig))
    del document["virtual"]
    for text in settings:
        key, value = parse_setting(text)
        if key.partition(".")[0] != "virtual":
            apply_setting(cast(dict[str, Any], document), key, value, "--set")
    for name, port in ports.items():
        document["devices"][name]["port"] = port
    write_whole_text(output, f"{_FIRST_LINE}\n{tomlkit.dumps(document)}")


def _text(rig: str) -> str:
    if not Path(rig).suffix and rig in shipped_rigs():
        return (resources.files("rig_configs") / f"{rig}.toml").read_text(encoding="utf-8")
    return read_text(Path(rig))
