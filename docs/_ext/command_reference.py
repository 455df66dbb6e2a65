"""The reference of all commands in their groups, for the page docs/commands.md."""

from __future__ import annotations

import itertools
import re

from cyclopts import App

from rig_cli.command_groups import COMMANDS, GROUPS
from rig_cli.main import commands

_COMMAND = re.compile(r"^### rig (\S+)$", re.MULTILINE)


def overview() -> str:
    """Return a list of all commands with their sentences, in the groups and the order of `rig --help`."""
    lines: list[str] = []
    for title, group in GROUPS.items():
        lines += ["", f"**{title}**", ""]
        lines += [f"- [`rig {name}`](#rig-{name}): {command.sentence}" for name, command in group.items()]
    return "\n".join(lines[1:])


def reference() -> str:
    """Return the help of every command, in the groups and the order of `rig --help`."""
    app: App = commands(COMMANDS)  # all modules are imported
    text = app.generate_docs(output_format="markdown", heading_level=2)
    starts = [*_COMMAND.finditer(text), None]
    sections = {
        start[1]: text[start.start() : None if end is None else end.start()].rstrip()
        for start, end in itertools.pairwise(starts)
        if start is not None
    }
    parts: list[str] = []
    for title, group in GROUPS.items():
        parts += [f"## {title}", *(sections[name] for name in group)]
    return re.sub(r"\*(?=\d)", r"\\*", "\n\n".join(parts)) + "\n"
