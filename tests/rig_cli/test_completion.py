"""`rig completion`: what a real shell makes of it."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from rig_cli.main import run

COMPLETE = 'source "{script}"; COMP_WORDS=({words}); COMP_CWORD={at}; _rig; printf "%s\\n" "${{COMPREPLY[@]}}"'


@pytest.fixture(scope="module")
def bash(tmp_path_factory: pytest.TempPathFactory) -> Path:
    import contextlib
    import io

    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        assert run(["completion", "bash"]) == 0
    script = tmp_path_factory.mktemp("shell") / "rig.bash"
    script.write_text(out.getvalue(), encoding="utf-8")
    return script


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash on this machine")
@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("rig", "rep"), {"report", "replay", "reproduce"}),
        (("rig", "parameters", "h"), {"history"}),
        (("rig", "report", "--si"), {"--since"}),
        (("rig", "record", "--dur"), {"--duration"}),
    ],
)
def test_bash_completes_commands_and_options(bash: Path, words: tuple[str, ...], expected: set[str]) -> None:
    line = COMPLETE.format(script=bash, words=" ".join(words), at=len(words) - 1)
    done = subprocess.run(["bash", "-c", line], capture_output=True, text=True, timeout=60, check=True)
    assert set(done.stdout.split()) == expected


@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_other_shells_get_a_script_they_can_read(
    shell: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert run(["completion", shell]) == 0
    text = capsys.readouterr().out
    assert all(word in text for word in ("report", "since", "record", "duration"))
    if (found := shutil.which(shell)) is not None:
        script = tmp_path / f"rig.{shell}"
        script.write_text(text, encoding="utf-8")
        subprocess.run([found, "-n", str(script)], check=True, timeout=60)
