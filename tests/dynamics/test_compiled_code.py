"""Compiled code never outlives the sources it came from, and the user's own choice of place stays."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from dynamics import compiled_code

ROOT = Path(__file__).parents[2]

FAR_CALLER = """
import numpy as np
from dynamics.compiled_code import keep_compiled_code
keep_compiled_code()
from dynamics import SpeedHistory
from dynamics.motions.fixed_steps import integrate
from tests.dynamics.nominal import rig
turn, start = SpeedHistory.constant(1.0), np.zeros(8)
start[0] = 0.1
packed = rig().packed()
end = integrate(start, np.array([0.0, 1e-3]), 1e-4, turn.knots_s, turn.coefficients, packed, 0.0, 0.0)[-1]
print(float(end[4]))
"""


def run_in(place: Path, home: Path, program: str) -> list[str]:
    environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
    environment |= {"HOME": str(home), "XDG_CACHE_HOME": str(home), "LOCALAPPDATA": str(home), "PYTHONPATH": str(place)}
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=place, env=environment, capture_output=True, text=True, check=True
    )
    return done.stdout.split()


def test_a_changed_kernel_is_not_run_from_old_code(tmp_path: Path) -> None:
    """The integrator's file stays as it is; the kernel it calls, in another file, changes the spring's sign."""
    place, home = tmp_path / "checkout", tmp_path / "home"
    for package in ("dynamics", "rig_basics"):
        shutil.copytree(ROOT / package, place / package, ignore=shutil.ignore_patterns("__pycache__"))
    (place / "tests" / "dynamics").mkdir(parents=True)
    shutil.copy(ROOT / "tests" / "dynamics" / "nominal.py", place / "tests" / "dynamics")
    before = run_in(place, home, FAR_CALLER)
    assert run_in(place, home, FAR_CALLER) == before
    kernel = place / "dynamics" / "equations" / "kernels.py"
    text = kernel.read_text(encoding="utf-8")
    assert text.count("+ p[K1] * ux") == 1
    kernel.write_text(text.replace("+ p[K1] * ux", "- p[K1] * ux"), encoding="utf-8")
    assert float(run_in(place, home, FAR_CALLER)[0]) == pytest.approx(-float(before[0]), rel=0.01)


KERNEL = """
from numba import njit
from daq.channels import SUSPECT_BEFORE

@njit(cache=True)
def flag():
    return SUSPECT_BEFORE
"""

FROZEN_FLAG = """
from dynamics.compiled_code import keep_compiled_code
keep_compiled_code()
from daq.channels import SUSPECT_BEFORE
from daq.flag_kernel import flag
print(flag(), SUSPECT_BEFORE)
"""


def test_a_changed_number_of_another_file_is_not_read_from_old_code(tmp_path: Path) -> None:
    """Compiled code, as that of the spike watch, writes the flag that the reader of the samples tests."""
    place = tmp_path / "checkout"
    for package in ("daq", "dynamics", "rig_basics"):
        shutil.copytree(ROOT / package, place / package, ignore=shutil.ignore_patterns("__pycache__"))
    (place / "daq" / "flag_kernel.py").write_text(KERNEL, encoding="utf-8")
    assert run_in(place, tmp_path / "home", FROZEN_FLAG) == ["1", "1"]
    channels = place / "daq" / "channels.py"
    text = channels.read_text(encoding="utf-8")
    assert text.count("SUSPECT_BEFORE, SUSPECT_PLACES = 0x1, 10") == 1
    channels.write_text(text.replace("SUSPECT_PLACES = 0x1, 10", "SUSPECT_PLACES = 0x4, 10"), encoding="utf-8")
    assert run_in(place, tmp_path / "home", FROZEN_FLAG) == ["4", "4"]


@pytest.mark.parametrize("name", ["NUMBA_OPT", "NUMBA_BOUNDSCHECK"])
def test_the_options_of_the_compiler_belong_to_the_digest(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    before = compiled_code.source_digest()
    monkeypatch.setenv(name, "1")
    assert compiled_code.source_digest() != before


@pytest.mark.parametrize("name", ["NUMBA_NUM_THREADS", "NUMBA_CACHE_DIR"])
def test_variables_that_change_no_code_do_not_compile_again(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    before = compiled_code.source_digest()
    monkeypatch.setenv(name, "1")
    assert compiled_code.source_digest() == before


IMPORTER = """
import os, sys
def own():
    return {k: v for k, v in os.environ.items() if k.startswith("NUMBA")}
before = own()
from dynamics import compiled_code
compiled_code.source_digest = lambda: sys.exit("importing hashed the sources")
import rig_configs, dynamics, identification, analysis
from dynamics import simulate, release_outcome
import numba
print(own() == before, repr(numba.config.CACHE_DIR))
"""


def test_importing_the_packages_leaves_numba_as_the_program_has_it() -> None:
    environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
    done = subprocess.run(
        [sys.executable, "-c", IMPORTER], cwd=ROOT, env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["True", "''"]


def test_where_the_users_cache_cannot_be_written_a_place_of_the_process_is_used(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """With read-only sources and without a home directory numba has no cache directory and does not compile."""
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setitem(sys.modules, "numba", type(sys)("numba"))
    monkeypatch.setattr(sys.modules["numba"], "config", SimpleNamespace(), raising=False)
    (tmp_path / "file").write_text("no directory")
    monkeypatch.setattr(compiled_code, "_user_cache", lambda: tmp_path / "file")
    place = compiled_code.keep_compiled_code()
    assert place is not None
    assert place.is_dir()
    assert os.environ["NUMBA_CACHE_DIR"] == str(place)
    shutil.rmtree(place)


def test_the_users_own_place_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", "elsewhere")
    assert compiled_code.keep_compiled_code() is None
    assert os.environ["NUMBA_CACHE_DIR"] == "elsewhere"


def test_directories_of_old_versions_go_and_recent_ones_stay(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setattr(compiled_code, "_user_cache", lambda: tmp_path)
    monkeypatch.setitem(sys.modules, "numba", type(sys)("numba"))
    monkeypatch.setattr(sys.modules["numba"], "config", SimpleNamespace(), raising=False)
    parent = tmp_path / "pendulum-balancer-rig"
    old, recent = parent / "compiled-old", parent / "compiled-recent"
    for place in (old, recent):
        place.mkdir(parents=True)
    long_ago = time.time() - 100 * 86400
    os.utime(old, (long_ago, long_ago))
    place = compiled_code.keep_compiled_code()
    assert place is not None
    assert place.is_dir()
    assert recent.is_dir()
    assert not old.exists()
