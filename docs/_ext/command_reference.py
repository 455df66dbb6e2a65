"""The command line as one cyclopts application whose commands are all imported, for the page docs/commands.md."""

from __future__ import annotations

from rig_cli.main import commands

_NAMES = [name for name in commands() if not name.startswith("-")]
APP = commands(_NAMES)
