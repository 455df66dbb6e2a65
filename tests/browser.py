"""A page in a real browser without a window."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from html import unescape
from pathlib import Path
from typing import Any

import pytest

BROWSER = next((b for b in map(shutil.which, ("chromium", "chromium-browser", "google-chrome")) if b), None)
needs_browser = pytest.mark.skipif(BROWSER is None, reason="no Chromium on this machine")
_QUIET = ("--disable-quic", "--disable-background-networking", "--disable-component-update", "--disable-sync")


def browse(page: Path, *options: str) -> str:
    """Open a file in the browser and return its standard output."""
    command = [str(BROWSER), "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", *_QUIET, *options]
    command += [f"--user-data-dir={page.parent / 'profile'}", page.as_uri()]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=True).stdout


def probed(page: Path, probe: str) -> dict[str, Any]:
    """Result of a script that runs in the page: JSON in an element "probe"."""
    page.write_text(page.read_text(encoding="utf-8").replace("</body>", probe), encoding="utf-8")
    shown = browse(page, "--window-size=1280,900", "--virtual-time-budget=5000", "--dump-dom")
    found = re.search(r'<pre id="probe">(.*?)</pre>', shown)
    assert found, shown[-500:]
    return json.loads(unescape(found[1]))
