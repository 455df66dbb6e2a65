"""Examples of packages from their wheels, each in a fresh virtual environment."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
_UV = os.environ.get("UV") or shutil.which("uv") or next(map(str, sorted(ROOT.glob(".tools/uv-*/bin/uv"))), None)


def python_with(example: str, folder: Path) -> str:
    """Return the Python of a fresh virtual environment with an example's wheel in it.

    The environment sees this one's libraries, so that nothing is downloaded; the example is installed only there.
    """
    if _UV is None:
        pytest.skip("needs uv to build a wheel")
    shutil.copytree(ROOT / "examples" / example, folder / "source", ignore=shutil.ignore_patterns("__pycache__"))
    build = [_UV, "build", "--wheel", "--out-dir", str(folder), str(folder / "source")]
    if subprocess.run([*build, "--offline"], capture_output=True, check=False).returncode:
        subprocess.run(build, capture_output=True, check=True)
    (wheel,) = folder.glob("*.whl")
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(folder / "venv")], check=True)
    scripts = "Scripts" if sys.platform == "win32" else "bin"
    found = str(folder / "venv" / scripts / Path(sys.executable).name)
    ask = [found, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"]
    site = Path(subprocess.run(ask, capture_output=True, text=True, check=True).stdout.strip())
    install = [_UV, "pip", "install", "--offline", "--no-index", "--no-deps", "--python", found, str(wheel)]
    subprocess.run(install, capture_output=True, check=True)
    ours = sysconfig.get_path("purelib")
    (site / "ours.pth").write_text(f"import site; site.addsitedir({ours!r})\n{ROOT}\n")
    return found
