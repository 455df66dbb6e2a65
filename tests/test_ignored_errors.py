"""A handler that ends an error uses it, logs it, or states in a comment that the error is the usual case."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
USUAL = "# usual:"


def unexplained(path: Path) -> Iterator[int]:
    """Yield the lines of handlers and of `contextlib.suppress` that leave no trace of an error."""
    source = path.read_text("utf-8")
    lines = source.splitlines()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ExceptHandler):
            inside = [part for statement in node.body for part in ast.walk(statement)]
            leaves = any(isinstance(part, ast.Raise) or _logs(part) for part in inside)
            uses = any(isinstance(part, ast.Name) and part.id == node.name for part in inside if node.name)
            if not leaves and not uses and USUAL not in lines[node.lineno - 1]:
                yield node.lineno
        elif isinstance(node, ast.With | ast.AsyncWith):
            for item in node.items:
                if "suppress(" in ast.unparse(item.context_expr) and USUAL not in lines[node.lineno - 1]:
                    yield node.lineno


def _logs(part: ast.AST) -> bool:
    return isinstance(part, ast.Attribute) and isinstance(part.value, ast.Name) and part.value.id == "_log"


def test_each_ignored_error_leaves_a_line_or_is_usual() -> None:
    packages = sorted(path.parent for path in ROOT.glob("*/py.typed"))
    assert len(packages) > 10, "the packages are found"
    found = {
        path.relative_to(ROOT).as_posix(): lines
        for package in packages
        for path in sorted(package.rglob("*.py"))
        if (lines := list(unexplained(path)))
    }
    assert found == {}


def test_a_silent_handler_is_found(tmp_path: Path) -> None:
    module = tmp_path / "module.py"
    module.write_text(
        "try:\n    f()\nexcept OSError:\n    pass\n"
        "try:\n    f()\nexcept OSError:  # usual: the file is new\n    pass\n"
        "try:\n    f()\nexcept OSError as error:\n    print(error)\n"
        "try:\n    f()\nexcept OSError:\n    _log.debug('no')\n"
        "with contextlib.suppress(OSError):\n    f()\n"
    )
    assert sorted(unexplained(module)) == [3, 17]
