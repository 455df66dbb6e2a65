# pyright: reportUnknownVariableType=false, reportUnknownArgumentType=false
"""The tutorials: executed in a kernel of their own, and held against what they may use and what is stored in them.

python -m tests.tutorials.notebooks            # all of docs/tutorials again, outputs kept in the files
python -m tests.tutorials.notebooks first_campaign
"""

from __future__ import annotations

import ast
import base64
import copy
import hashlib
import importlib
import io
import os
import re
import sys
import tempfile
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import nbformat
from nbclient import NotebookClient
from nbformat import NotebookNode
from PIL import Image

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "docs" / "tutorials"
PACKAGES = ("analysis", "daq", "dynamics", "identification", "rig_configs", "rig_testing", "uncertainty")
"""Packages whose public names a tutorial may use; other packages of the project are not for tutorials."""
OURS = (*PACKAGES, "benchmarks", "rig_cli", "live", "tests")
VARIES = "varies"
DIGEST = "executed_sources_sha256"
_LONGEST_S = 600
_COLOURS = 96  # of a stored figure
_STRICT = textwrap.dedent("""
    import socket as _socket, warnings as _warnings
    def _refuse(self, address, *rest):
        if self.family != getattr(_socket, "AF_UNIX", None):
            raise OSError(f"a tutorial needs no network, yet it connects to {address!r}")
    _socket.socket.connect = _socket.socket.connect_ex = _refuse
    _warnings.simplefilter("error")
    _warnings.filterwarnings("ignore", module="ipykernel|IPython|jupyter_client|traitlets|zmq")
""")
_MACHINE = re.compile(r"(?<![\w.:/])/(?:home|root|tmp|usr|opt|var|work|mnt|private|Users)/|\b[A-Z]:\\\\?[A-Za-z]")
_NUMBER = re.compile(r"[-+−]?\d[\d.,]*(?:[eE][-+]?\d+)?")


def tutorials() -> list[Path]:
    """All notebooks, by name."""
    return sorted(FOLDER.glob("*.ipynb"))


def read(path: Path) -> NotebookNode:
    """A notebook, checked against its format."""
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    return notebook


def code_cells(notebook: NotebookNode) -> list[NotebookNode]:
    """Cells with code, in order."""
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def sources_digest(notebook: NotebookNode) -> str:
    """SHA-256 of all code of a notebook."""
    return hashlib.sha256("\0".join(cell.source for cell in code_cells(notebook)).encode()).hexdigest()


# --- executed ----------------------------------------------------------------------------------------------------


def executed(notebook: NotebookNode, folder: Path) -> NotebookNode:
    """A copy with fresh outputs, made in a folder where nothing else is; warnings and networks are errors.

    Raises:
        CellExecutionError: a cell failed; the text shows which, and its traceback.
    """
    fresh = copy.deepcopy(notebook)
    for cell in code_cells(fresh):
        cell.outputs, cell.execution_count = [], None
        cell.metadata.pop("execution", None)
    strict = nbformat.v4.new_code_cell(_STRICT, id="strict")
    fresh.cells.insert(0, strict)
    with _own_settings(folder):
        client = NotebookClient(
            fresh,
            timeout=_LONGEST_S,
            kernel_name="python3",
            record_timing=False,
            coalesce_streams=True,
            extra_arguments=["--log-level=ERROR"],
            resources={"metadata": {"path": str(folder)}},
        )
        client.execute()
    fresh.cells.remove(strict)
    for number, cell in enumerate(code_cells(fresh), 1):
        cell.execution_count = number
        for output in cell.outputs:
            if "execution_count" in output:
                output.execution_count = number
            if "image/png" in output.get("data", {}):
                output.data["image/png"] = _small(output.data["image/png"])
    fresh.metadata = NotebookNode(
        kernelspec={"display_name": "Python 3", "language": "python", "name": "python3"},
        language_info={"name": "python"},
    )
    fresh.metadata[DIGEST] = sources_digest(fresh)
    return fresh


@contextmanager
def _own_settings(folder: Path) -> Iterator[None]:
    """Exclude the user's IPython and Jupyter settings and silence the kernel's debugger."""
    ours = {
        "IPYTHONDIR": str(folder / ".ipython"),
        "JUPYTER_CONFIG_DIR": str(folder / ".jupyter"),
        "JUPYTER_NO_CONFIG": "1",
        "PYDEVD_DISABLE_FILE_VALIDATION": "1",
        "MPLBACKEND": "",
    }
    before = {name: os.environ.get(name) for name in ours}
    os.environ.update({name: value for name, value in ours.items() if value})
    os.environ.pop("MPLBACKEND", None)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _small(png: str) -> str:
    """A figure of a few colours takes a third of the room with a palette."""
    picture, out = Image.open(io.BytesIO(base64.b64decode(png))).convert("RGB"), io.BytesIO()
    picture.quantize(_COLOURS, dither=Image.Dither.NONE).save(out, "png", optimize=True)
    return base64.b64encode(out.getvalue()).decode()


# --- what a tutorial may use -----------------------------------------------------------------------------------------


def private_uses(code: str) -> list[str]:
    """What a cell takes of the project that is not public, and how else it reaches behind a package's door."""
    code = "\n".join("" if line == "%matplotlib inline" else line for line in code.splitlines())
    found: list[str] = []
    for node in ast.walk(ast.parse(code)):
        match node:
            case ast.Import():
                found += [f"import {a.name}: import its names" for a in node.names if _root(a.name) in OURS]
                found += [f"import {a.name}" for a in node.names if _root(a.name) == "importlib"]
            case ast.ImportFrom(module=module) if module and _root(module) in OURS:
                found += [f"from {module} import {a.name}" for a in node.names if a.name not in _public(module)]
            case ast.ImportFrom(module=module) if node.level or module == "importlib":
                found.append(f"from {'.' * node.level}{module or ''} import …")
            case ast.Attribute(attr=attr) if attr.startswith("_"):
                found.append(f".{attr}")
            case ast.Name(id="__import__" | "exec" | "eval" as name):
                found.append(name)
            case _:
                pass
    return found


def _root(module: str) -> str:
    return module.partition(".")[0]


def _public(module: str) -> Sequence[str]:
    """Return the public names of a package; a module in a package has none."""
    if _root(module) not in PACKAGES or any(part.startswith("_") for part in module.split(".")):
        return ()
    home = importlib.import_module(module)
    return getattr(home, "__all__", ()) if hasattr(home, "__path__") else ()


# --- what is stored --------------------------------------------------------------------------------------------------


def kinds(cell: NotebookNode) -> list[str]:
    """What a cell's outputs are: of figures that they are some, of texts all but the numbers.

    Of a cell with the tag VARIES only that there is a text: what lies at a byte of a file depends on its packing.
    """
    found: list[str] = []
    for output in cell.outputs:
        if output.output_type == "stream":
            found.append(f"{output.name}: {'…' if VARIES in cell.metadata.get('tags', ()) else _shape(output.text)}")
        elif "image/png" in output.data:
            found.append("figure")
        else:
            found.append(f"{output.output_type}: {_shape(output.data.get('text/plain', ''))}")
    return found


def _shape(text: str) -> str:
    return " ".join(_NUMBER.sub("#", text).split())


def complaints_printed(notebook: NotebookNode) -> list[str]:
    """Outputs that are errors, or words on standard error."""
    outputs: list[Mapping[str, Any]] = [output for cell in code_cells(notebook) for output in cell.outputs]
    errors = [str(o["ename"]) for o in outputs if o["output_type"] == "error"]
    return errors + [str(o["text"]) for o in outputs if o["output_type"] == "stream" and o["name"] == "stderr"]


def machine_paths(notebook: NotebookNode) -> list[str]:
    """Return the lines of outputs and texts that contain a path of one machine."""
    texts = [cell.source for cell in notebook.cells]
    for cell in code_cells(notebook):
        for output in cell.outputs:
            texts += [output.get("text", ""), *(v for k, v in output.get("data", {}).items() if k != "image/png")]
    return [line for text in texts for line in str(text).splitlines() if _MACHINE.search(line)]


def main(names: Sequence[str]) -> int:
    """Execute tutorials again and keep their outputs."""
    from dynamics.compiled_code import keep_compiled_code

    keep_compiled_code()
    for path in [FOLDER / f"{name}.ipynb" for name in names] or tutorials():
        with tempfile.TemporaryDirectory() as folder:
            fresh = executed(read(path), Path(folder))
        if complaints := complaints_printed(fresh):
            print(f"{path.name}: not kept, for it complains: {'; '.join(complaints)}", file=sys.stderr)
            return 1
        nbformat.write(fresh, path)
        print(f"{path.relative_to(ROOT)}: {path.stat().st_size / 1e3:.0f} kB")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
