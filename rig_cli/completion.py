"""The command that prints what a shell needs to complete `rig`."""

from __future__ import annotations

from typing import Literal

from rig_cli.console import print_json
from rig_cli.options import Json


def completion(shell: Literal["bash", "zsh", "fish"], *, json: Json = False) -> int:
    """Print the script with which a shell completes commands and options of rig.

    bash: rig completion bash > ~/.local/share/bash-completion/completions/rig

    zsh: rig completion zsh > a folder of $fpath/_rig

    fish: rig completion fish > ~/.config/fish/completions/rig.fish

    Example: `rig completion bash`

    Args:
        shell: the shell.
    """
    from rig_cli.main import commands  # it lists this command too

    script = commands().generate_completion(prog_name="rig", shell=shell)
    if json:
        print_json({"shell": shell, "script": script})
    else:
        print(script)
    return 0
