"""The public names of the packages exist, are imported at their first use, and importing writes nothing."""

from __future__ import annotations

import ast
import importlib
import re
import subprocess
import sys
import tomllib
from inspect import isclass, isroutine
from pathlib import Path

import pytest

from daq.version import software_version

ROOT = Path(__file__).parents[1]
STUBS = sorted(path for path in ROOT.glob("*/**/__init__.pyi") if "site-packages" not in path.parts)
PACKAGES = [".".join(stub.parent.relative_to(ROOT).parts) for stub in STUBS]
HEAVY = ("numba", "scipy", "matplotlib", "pyarrow", "h5py", "sympy", "bokeh", "starlette")


def test_the_packages_are_found() -> None:
    assert {"daq", "dynamics", "identification", "analysis", "uncertainty", "rig_configs"} <= set(PACKAGES)


@pytest.mark.parametrize("package", PACKAGES)
def test_each_listed_name_exists_and_is_described(package: str) -> None:
    module = importlib.import_module(package)
    listed = [
        alias.name
        for node in ast.parse(STUBS[PACKAGES.index(package)].read_text("utf-8")).body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    ]
    assert sorted(listed) == sorted(module.__all__)
    assert set(listed) <= set(dir(module))
    found = [getattr(module, name) for name in listed]
    assert [each for each in found if (isclass(each) or isroutine(each)) and not each.__doc__] == []


def test_importing_the_packages_loads_no_large_library_and_writes_no_file(tmp_path: Path) -> None:
    names = [name for name in PACKAGES if "." not in name]
    program = f"import sys, {', '.join(names)}\nprint(*sorted(set({HEAVY!r}) & set(sys.modules)))"
    environment = {
        "PYTHONPATH": str(ROOT),
        "HOME": str(tmp_path),
        "XDG_CACHE_HOME": str(tmp_path),
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    loaded = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
    )
    assert loaded.stdout.split() == []
    assert list(tmp_path.iterdir()) == []


def test_a_recording_loads_no_compiler() -> None:
    """What is compiled at the first byte of a device delays it, from a cold cache by seconds."""
    program = (
        "import sys, daq.acquisition.session\n"
        "from daq.drivers.registry import driver\n"
        "from rig_configs.drivers import installed\n"
        "for name in installed(): driver(name).load()\n"
        "print(*sorted({'numba', 'scipy', 'matplotlib'} & set(sys.modules)))"
    )
    loaded = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True)
    assert loaded.stdout.split() == []


def test_a_name_that_is_not_listed_is_refused() -> None:
    with pytest.raises(AttributeError):
        importlib.import_module("identification").no_such_name  # noqa: B018


def test_the_version_is_the_same_everywhere() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    cited = re.search(r"^version: (\S+)$", (ROOT / "CITATION.cff").read_text("utf-8"), re.MULTILINE)
    changes = re.search(r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text("utf-8"), re.MULTILINE)
    assert cited is not None
    assert changes is not None
    assert project["version"] == cited[1] == changes[1] == software_version()
