"""Mutation testing of the rooms on which a verdict rests: which small errors in the code do the tests not detect?

    uv run --group mutation python -m benchmarks.mutants --room settling --count 60 --seed 1 --out out/mutants.jsonl

The mutations are cosmic-ray's. A sample is drawn with the same probability for every place in the code that can be
mutated, whatever the number of variants there. Each mutant is written into a private copy of the project, and the
room's nearest tests (mutants.toml) run there until one fails. Mutants that no test can detect because the behaviour is
the same are listed with the reason in mutants_equivalent.toml and are not counted.
"""

from __future__ import annotations

import argparse
import ast
import concurrent.futures
import contextlib
import difflib
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from cosmic_ray.ast import Visitor, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.operators.provider import OperatorProvider

ROOT = Path(__file__).resolve().parents[1]
LEFT_OUT = ("VariableReplacer", "VariableInserter")  # they need the names of variables
LEAST_TIMEOUT_S = 120.0


@dataclass(frozen=True)
class Mutant:
    """One mutation: operator and its occurrence in a module, and the first changed line before and after."""

    room: str
    module: str
    line: int
    operator: str
    occurrence: int
    before: str
    after: str

    @property
    def key(self) -> str:
        """Identity that does not depend on line numbers."""
        return f"{self.module}: {self.before} -> {self.after}"


@dataclass(frozen=True)
class Verdict:
    """Outcome of one mutant: "killed", "survived" or "timeout", by which test, after how many seconds."""

    mutant: Mutant
    outcome: str
    test: str
    seconds: float


def main() -> None:
    """Draw mutants, run the tests against each, print the survivors and the share that was killed."""
    rooms = tomllib.loads((ROOT / "benchmarks/mutants.toml").read_text(encoding="utf-8"))
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--room", choices=sorted(rooms), action="append")
    parser.add_argument("--count", type=int, default=60, help="mutants drawn from each room")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("out/mutants.jsonl"))
    options = parser.parse_args()
    equivalent = equivalents()
    options.out.parent.mkdir(parents=True, exist_ok=True)
    done = {json.loads(line)["key"] for line in options.out.open()} if options.out.exists() else set[str]()
    for room in options.room or sorted(rooms):
        drawn = [
            m for m in sample(room, rooms[room]["modules"], options.count, options.seed) if m.key not in equivalent
        ]
        to_run = [m for m in drawn if m.key not in done]
        with options.out.open("a", encoding="utf-8") as kept:
            for verdict in run(to_run, rooms[room]["tests"], options.jobs):
                kept.write(json.dumps({"key": verdict.mutant.key, **asdict(verdict)}, ensure_ascii=False) + "\n")
                kept.flush()
                if verdict.outcome == "survived":
                    print(f"survived {verdict.mutant.module}:{verdict.mutant.line}")
                    print(f"    - {verdict.mutant.before}\n    + {verdict.mutant.after}", flush=True)
        print(summary(room, {m.key for m in drawn}, options.out), flush=True)


def equivalents() -> dict[str, str]:
    """Mutants without a difference in behaviour: key to reason."""
    path = ROOT / "benchmarks/mutants_equivalent.toml"
    return {entry["mutant"]: entry["reason"] for entry in tomllib.loads(path.read_text(encoding="utf-8"))["equivalent"]}


def summary(room: str, keys: set[str], results: Path) -> str:
    """Share of a room's drawn mutants that the tests detect."""
    rows = [row for row in map(json.loads, results.open()) if row["key"] in keys]
    killed = sum(row["outcome"] != "survived" for row in rows)
    return f"{room}: {killed} of {len(rows)} mutants detected ({100 * killed / max(len(rows), 1):.1f} %)"


def sample(room: str, patterns: list[str], count: int, seed: int) -> list[Mutant]:
    """Draw mutants of a room's modules, one for each drawn place in the code."""
    places = defaultdict[tuple[str, int, int, str], list[tuple[str, int]]](list)
    for pattern in patterns:
        for path in sorted(ROOT.glob(pattern)):
            for operator, occurrence, line, column in mutations(path):
                family = operator.split("_")[0]
                places[(path.relative_to(ROOT).as_posix(), line, column, family)].append((operator, occurrence))
    draw = random.Random(f"{room} {seed}")
    chosen = draw.sample(sorted(places), min(count, len(places)))
    return [found for place in chosen if (found := _mutant(room, place[0], place[1], *draw.choice(places[place])))]


def mutations(path: Path) -> Iterator[tuple[str, int, int, int]]:
    """Every mutation of a module outside annotations and imports for type checking: operator, occurrence, position."""

    source = path.read_text(encoding="utf-8")
    skipped = _not_executed(ast.parse(source))
    tree = get_ast(source)
    provider = OperatorProvider()
    for name in provider:
        if name in LEFT_OUT:
            continue
        operator = provider[name]()
        positions: list[Any] = []

        class Collect(Visitor):
            def visit(self, node: Any, operator: Any = operator, positions: list[Any] = positions) -> Any:
                positions.extend(operator.mutation_positions(node))
                return node

        Collect().walk(tree)
        for occurrence, ((line, column), _) in enumerate(positions):
            if not any(first <= (line, column) <= last for first, last in skipped):
                yield name, occurrence, line, column


def _not_executed(tree: ast.Module) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """Spans of annotations and of blocks for type checkers."""
    nodes: list[ast.expr | ast.If] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.arg | ast.AnnAssign) and node.annotation:
            nodes.append(node.annotation)
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and node.returns:
            nodes.append(node.returns)
        elif isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            nodes.append(node)
    return [((n.lineno, n.col_offset), (n.end_lineno or 0, n.end_col_offset or 0)) for n in nodes]


def _mutant(room: str, module: str, line: int, operator: str, occurrence: int) -> Mutant | None:
    source = (ROOT / module).read_text(encoding="utf-8")
    mutated = _mutated(source, operator, occurrence)
    changes = [text for text in difflib.ndiff(source.splitlines(), mutated.splitlines()) if text[0] in "+-"]
    before = next((text[2:].strip() for text in changes if text[0] == "-"), "")
    after = next((text[2:].strip() for text in changes if text[0] == "+"), "")
    return Mutant(room, module, line, operator, occurrence, before, after) if changes else None


def _mutated(source: str, operator: str, occurrence: int) -> str:

    return mutate_code(source, OperatorProvider()[operator](), occurrence) or source


def run(mutants: list[Mutant], tests: list[str], jobs: int) -> Iterator[Verdict]:
    """Run the tests against each mutant, `jobs` at a time, each in a private copy of the project."""
    if not mutants:
        return
    with contextlib.ExitStack() as stack:
        copies = [_copy(stack) for _ in range(jobs)]
        started = time.monotonic()
        code, words = _tests(copies[0], tests, None)
        if code != 0:
            raise SystemExit(f"the tests fail without a mutation:\n{words}")
        timeout = max(LEAST_TIMEOUT_S, 5 * (time.monotonic() - started))
        free = list(copies)
        with concurrent.futures.ThreadPoolExecutor(jobs) as pool:

            def one(mutant: Mutant) -> Verdict:
                copy = free.pop()
                try:
                    return _judge(copy, mutant, tests, timeout)
                finally:
                    free.append(copy)

            for future in concurrent.futures.as_completed([pool.submit(one, m) for m in mutants]):
                yield future.result()


def _copy(stack: contextlib.ExitStack) -> Path:
    folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="mutants-")))
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for name in filter(None, listed.split("\0")):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(ROOT / name, folder / name)
    return folder


def _judge(copy: Path, mutant: Mutant, tests: list[str], timeout: float) -> Verdict:
    path = copy / mutant.module
    source = path.read_text(encoding="utf-8")
    started = time.monotonic()
    try:
        path.write_text(_mutated(source, mutant.operator, mutant.occurrence), encoding="utf-8")
        code, words = _tests(copy, tests, timeout)
    finally:
        path.write_text(source, encoding="utf-8")
    outcome = "timeout" if code is None else "survived" if code == 0 else "killed"
    failed = next((line for line in words.splitlines() if line.startswith(("FAILED", "ERROR"))), "")
    return Verdict(mutant, outcome, failed[:200], round(time.monotonic() - started, 1))


def _tests(copy: Path, tests: list[str], timeout: float | None) -> tuple[int | None, str]:
    environment = {
        **os.environ,
        "PYTHONPATH": str(copy),
        "PYTHONDONTWRITEBYTECODE": "1",
        "NUMBA_CACHE_DIR": f"{copy}/.numba",
    }
    command = [sys.executable, "-m", "pytest", "-x", "-q", "--no-header", "-p", "no:cacheprovider", *tests]
    try:
        done = subprocess.run(
            command, cwd=copy, env=environment, capture_output=True, text=True, timeout=timeout, check=False
        )
    except subprocess.TimeoutExpired:
        return None, ""
    return done.returncode, done.stdout


if __name__ == "__main__":
    main()
