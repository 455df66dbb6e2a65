"""The files that compiled functions are made of, found again from the syntax trees of all packages."""

from __future__ import annotations

import ast
import shutil
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from dynamics.compiled_code import source_digest
from rig_basics.compiled_sources import PACKAGES, compiled_sources

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
WHEEL = PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]
COMPILERS = {"njit", "jit", "vectorize", "guvectorize", "cfunc", "stencil", "overload", "intrinsic", "compiled"}


@cache
def tree_of(file: str) -> ast.Module:
    return ast.parse((ROOT / file).read_bytes())


def imports(file: str) -> Iterator[tuple[str, str, str]]:
    """Yield (name in the file, module, name in the module, "" for the module itself) of the imports at top level."""
    package = file.rpartition("/")[0].split("/")
    for statement in top_level(tree_of(file).body):
        if isinstance(statement, ast.ImportFrom):
            start = ".".join(package[: len(package) - statement.level + 1]) if statement.level else ""
            module = ".".join(filter(None, (start, statement.module)))
            yield from ((alias.asname or alias.name, module, alias.name) for alias in statement.names)
        elif isinstance(statement, ast.Import):
            yield from ((alias.asname or alias.name, alias.name, "") for alias in statement.names)


def top_level(body: list[ast.stmt]) -> Iterator[ast.stmt]:
    """Yield the statements that run when a module is imported, without those of `if TYPE_CHECKING`."""
    for statement in body:
        yield statement
        if isinstance(statement, ast.If) and ast.unparse(statement.test) != "TYPE_CHECKING":
            yield from top_level([*statement.body, *statement.orelse])
        elif isinstance(statement, ast.Try):
            handlers = [each for handler in statement.handlers for each in handler.body]
            yield from top_level([*statement.body, *handlers, *statement.orelse, *statement.finalbody])


def compilers_of(file: str) -> set[str]:
    """Return the names by which a file calls a compiler."""
    return {
        name
        for name, module, original in imports(file)
        if (module.split(".")[0] == "numba" or module == "dynamics.compiled_code")
        and original in COMPILERS | {"", "numba"}
    }


def compiled_functions(file: str) -> list[ast.AST]:
    """Return the functions with a compiler's decorator and the calls of a compiler."""
    compilers = compilers_of(file)

    def compiles(node: ast.AST) -> bool:
        called = node.func if isinstance(node, ast.Call) else node
        if isinstance(called, ast.Attribute) and isinstance(called.value, ast.Name):
            return called.value.id in compilers and called.attr in COMPILERS
        return isinstance(called, ast.Name) and called.id in compilers

    return [
        node
        for node in ast.walk(tree_of(file))
        if (isinstance(node, ast.FunctionDef) and any(compiles(each) for each in node.decorator_list))
        or (isinstance(node, ast.Call) and compiles(node))
    ]


@cache
def files_with_compiled_functions() -> tuple[str, ...]:
    """Search all packages of the wheel. A file that compiles contains the name of numba or of `compiled_code`."""
    files = [path for package in WHEEL for path in sorted((ROOT / package).rglob("*.py"))]
    near = [path for path in files if any(word in path.read_bytes() for word in (b"numba", b"compiled_code"))]
    names = [path.relative_to(ROOT).as_posix() for path in near]
    return tuple(name for name in names if compiled_functions(name))


def file_of(module: str, suffix: str = ".py") -> str | None:
    stem = module.replace(".", "/")
    return next((name for name in (f"{stem}{suffix}", f"{stem}/__init__{suffix}") if (ROOT / name).is_file()), None)


def origins(module: str, name: str) -> Iterator[str]:
    """Yield the files that determine a name of a module, through all files that only pass it on."""
    submodule = file_of(f"{module}.{name}") if name else None
    if submodule is not None:
        yield submodule
        return
    file = file_of(module)
    if file is None or module.partition(".")[0] not in WHEEL:
        return
    yield file
    for source in filter(None, (file, file_of(module, ".pyi"))):
        for own, further, original in imports(source):
            if own == name:
                yield from origins(further, original)


def frozen_files(file: str) -> set[str]:
    """Return the files of the project from which the names in a file's compiled functions come."""
    imported = {name: (module, original) for name, module, original in imports(file)}
    used = {
        node.id for function in compiled_functions(file) for node in ast.walk(function) if isinstance(node, ast.Name)
    }
    return {origin for name in used & imported.keys() for origin in origins(*imported[name])}


def test_no_compiled_function_stands_in_a_file_outside_the_set() -> None:
    holding = set(files_with_compiled_functions())
    assert {name.split("/")[0] for name in holding} >= {"analysis", "daq", "dynamics", "identification"}
    assert not holding - compiled_sources(ROOT).keys()


def test_every_file_whose_names_a_compiled_function_reads_belongs_to_the_set() -> None:
    frozen = set[str]().union(*(frozen_files(name) for name in files_with_compiled_functions()))
    assert "dynamics/equations/kernels.py" in frozen
    assert not frozen - compiled_sources(ROOT).keys()


def test_the_set_is_closed_under_the_imports_of_its_modules() -> None:
    """A number that a module of the set computes from another module's numbers is frozen too."""
    found = compiled_sources(ROOT).keys()
    python = [name for name in found if name.endswith(".py")]
    needed = {
        origin for name in python for _, module, original in imports(name) for origin in origins(module, original)
    }
    assert not {name for name in needed if name.split("/")[0] in PACKAGES} - found


@pytest.fixture(scope="module")
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("checkout")
    for package in PACKAGES:
        shutil.copytree(ROOT / package, place / package, ignore=shutil.ignore_patterns("__pycache__"))
    return place


def test_a_change_of_each_compiled_source_and_of_each_frozen_file_changes_the_digest(checkout: Path) -> None:
    holding = set(files_with_compiled_functions())
    before, kept = source_digest(checkout), list[str]()
    assert before == source_digest(ROOT)
    for name in sorted(holding.union(*(frozen_files(each) for each in holding))):
        text = (checkout / name).read_bytes()
        (checkout / name).write_bytes(text + b"\n")
        if source_digest(checkout) == before:
            kept.append(name)
        (checkout / name).write_bytes(text)
    assert not kept


def test_files_outside_the_set_leave_the_digest_as_it_is(checkout: Path) -> None:
    before, found = source_digest(checkout), compiled_sources(checkout).keys()
    others = [path for path in checkout.rglob("*.py") if path.relative_to(checkout).as_posix() not in found]
    assert others
    for path in others:
        path.write_bytes(path.read_bytes() + b"\n# changed\n")
    assert source_digest(checkout) == before
