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
import contextlib
import difflib
import importlib
import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
import traceback
import warnings
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import pytest
from cosmic_ray.ast import Visitor, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.operators.provider import OperatorProvider

ROOT = Path(__file__).resolve().parents[1]
LEFT_OUT = ("VariableReplacer", "VariableInserter")  # they need the names of variables
LEAST_TIMEOUT_S = 120.0
PROTECTIONS = ("strict", "frozen")  # of zip and dataclass: no caller depends on them
FOR_SPEED = ("njit", "lru_cache")
POLL_S = 0.02
BROKEN = 70  # exit code of a process that did not run the tests
PYTEST = ("-x", "-q", "--no-header", "-p", "no:cacheprovider", "--hypothesis-seed=0")
PYTEST += ("-W", "ignore::pytest.PytestAssertRewriteWarning")  # plugins are imported before the fork
MODULES = "modules.json"
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


@dataclass(frozen=True)
class Mutant:
    """One mutation: operator and its occurrence in a module, and the changed lines before and after."""

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
    parser.add_argument("--module", default="", help="only modules whose path contains this text")
    parser.add_argument("--count", type=int, default=60, help="mutants drawn from each room")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("out/mutants.jsonl"))
    parser.add_argument("--again", action="store_true", help="judge the recorded survivors with the present tests")
    options = parser.parse_args()
    os.environ.update(dict.fromkeys(THREADS, "1"))
    equivalent = equivalents()
    options.out.parent.mkdir(parents=True, exist_ok=True)
    recorded = outcomes(options.out)
    done = {key for key, outcome in recorded.items() if not (options.again and outcome == "survived")}
    for room in options.room or sorted(rooms):
        modules = [name for name in modules_of(rooms[room]["modules"]) if options.module in name]
        drawn = [m for m in sample(room, modules, options.count, options.seed) if m.key not in equivalent]
        to_run = [m for m in drawn if m.key not in done]
        with options.out.open("a", encoding="utf-8") as kept:
            for verdict in run(to_run, rooms[room]["tests"], rooms[room].get("nearest", {}), options.jobs):
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


def outcomes(results: Path) -> dict[str, str]:
    """Key of each recorded mutant to its last outcome."""
    rows = map(json.loads, results.read_text(encoding="utf-8").splitlines()) if results.exists() else ()
    return {row["key"]: row["outcome"] for row in rows}


def summary(room: str, keys: set[str], results: Path) -> str:
    """Share of a room's drawn mutants that the tests detect."""
    found = [outcome for key, outcome in outcomes(results).items() if key in keys]
    killed = sum(outcome != "survived" for outcome in found)
    return f"{room}: {killed} of {len(found)} mutants detected ({100 * killed / max(len(found), 1):.1f} %)"


def modules_of(patterns: list[str]) -> list[str]:
    """Paths of the modules that glob patterns select, from the project's root."""
    return [path.relative_to(ROOT).as_posix() for pattern in patterns for path in sorted(ROOT.glob(pattern))]


def sample(room: str, modules: list[str], count: int, seed: int) -> list[Mutant]:
    """Draw mutants of some modules of a room, one for each drawn place in the code."""
    places = defaultdict[tuple[str, int, int, str], list[tuple[str, int]]](list)
    for module in modules:
        for operator, occurrence, line, column in mutations(ROOT / module):
            places[(module, line, column, operator.split("_")[0])].append((operator, occurrence))
    # each place has its own random numbers: a larger count continues a smaller one
    drawn = sorted(places, key=lambda place: random.Random(f"{room} {seed} {place}").random())[:count]
    variants = [random.Random(f"{seed} {place}").choice(places[place]) for place in drawn]
    mutants = (_mutant(room, place[0], place[1], *variant) for place, variant in zip(drawn, variants, strict=True))
    return [found for found in mutants if found is not None]


def mutations(path: Path) -> Iterator[tuple[str, int, int, int]]:
    """Every mutation of a module outside of `_not_executed` code: operator, occurrence, line, column."""

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
    """Spans of annotations, of blocks and protocols for type checkers, of code for speed or against programming errors.

    Annotations with calls are executed: pydantic's limits of a number.
    """
    nodes: list[ast.expr | ast.stmt] = []
    spans: list[tuple[tuple[int, int], tuple[int, int]]] = []
    for node in ast.walk(tree):
        for decorator in getattr(node, "decorator_list", ()):
            if ast.unparse(decorator).startswith(FOR_SPEED):
                end = (decorator.end_lineno or 0, decorator.end_col_offset or 0)
                spans.append(((decorator.lineno, 0), end))  # cosmic-ray's position of a decorator is its `@`
        if isinstance(node, ast.keyword) and node.arg in PROTECTIONS:
            nodes.append(node.value)
        if isinstance(node, ast.arg | ast.AnnAssign) and node.annotation:
            nodes.append(node.annotation)
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and node.returns:
            nodes.append(node.returns)
        elif (isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING") or (
            isinstance(node, ast.ClassDef) and any(ast.unparse(base).startswith("Protocol") for base in node.bases)
        ):
            nodes.append(node)
    nodes = [node for node in nodes if isinstance(node, ast.stmt) or not _is_limit(node)]
    return spans + [((n.lineno, n.col_offset), (n.end_lineno or 0, n.end_col_offset or 0)) for n in nodes]


def _is_limit(node: ast.expr) -> bool:
    return ast.unparse(node).startswith("Annotated") and any(isinstance(part, ast.Call) for part in ast.walk(node))


def _mutant(room: str, module: str, line: int, operator: str, occurrence: int) -> Mutant | None:
    """Return a mutant; None if the mutation changes nothing, or cosmic-ray cannot write it (`except errors.Class`)."""
    source = (ROOT / module).read_text(encoding="utf-8")
    try:
        mutated = _mutated(source, operator, occurrence)
    except AttributeError:
        return None
    changes = [text for text in difflib.ndiff(source.splitlines(), mutated.splitlines()) if text[0] in "+-"]
    before, after = (" ".join(" ".join(t[2:].strip() for t in changes if t[0] == sign).split()) for sign in "-+")
    if not after:  # a removed decorator
        lines = source.splitlines()
        removed = next(i for i in range(line - 1, len(lines)) if lines[i].strip().startswith("@"))
        before, after = f"{before} {lines[removed + 1].strip()}", lines[removed + 1].strip()
    return Mutant(room, module, line, operator, occurrence, before, after) if changes else None


def _mutated(source: str, operator: str, occurrence: int) -> str:

    return mutate_code(source, OperatorProvider()[operator](), occurrence) or source


def run(mutants: list[Mutant], tests: list[str], nearest: dict[str, list[str]], jobs: int) -> Iterator[Verdict]:
    """Run the tests against each mutant, `jobs` at a time, each in a private copy of the project.

    Args:
        mutants: the mutants.
        tests: the room's tests.
        nearest: module → tests that are run against its mutants in place of all of the room.
        jobs: number of processes.
    """
    if not mutants:
        return
    with contextlib.ExitStack() as stack:
        free = [_copy(stack) for _ in range(jobs)]
        needed = dict.fromkeys(test for m in mutants for test in nearest.get(m.module, tests))
        process = _start(free[0], list(needed), None)
        while (code := process.code()) is None:
            time.sleep(POLL_S)
        if code != 0:
            raise SystemExit(f"the tests fail without a mutation:\n{process.words()}")
        for module in json.loads((free[0] / MODULES).read_text(encoding="utf-8")):
            with contextlib.suppress(Exception), warnings.catch_warnings():
                warnings.simplefilter("ignore")
                importlib.import_module(module)  # inherited by the processes of the mutants, which start faster so
        limits = (max(LEAST_TIMEOUT_S, 4 * process.cpu_s), max(LEAST_TIMEOUT_S, 10 * process.seconds))
        waiting = list(reversed(mutants))
        running = list[tuple[Mutant, Path, str, tuple[int, int], _Process]]()
        for copy in free[1:]:
            shutil.copytree(free[0], copy, dirs_exist_ok=True)
        while waiting or running:
            while waiting and free:
                mutant, copy = waiting.pop(), free.pop()
                path = copy / mutant.module
                source, status = path.read_text(encoding="utf-8"), path.stat()
                times = (status.st_atime_ns, status.st_mtime_ns)
                path.write_text(_mutated(source, mutant.operator, mutant.occurrence), encoding="utf-8")
                own = nearest.get(mutant.module, tests)
                process = _start(copy, own, limits, compiled="njit" in source)
                running.append((mutant, copy, source, times, process))
            time.sleep(POLL_S)
            for entry in list(running):
                mutant, copy, source, times, process = entry
                if (code := process.code()) is None:
                    continue
                running.remove(entry)
                free.append(copy)
                (copy / mutant.module).write_text(source, encoding="utf-8")
                os.utime(copy / mutant.module, ns=times)  # its bytecode is valid again
                if code == BROKEN:
                    raise SystemExit(f"the tests did not run:\n{process.words()}")
                outcome = "timeout" if code < 0 else "survived" if code == 0 else "killed"
                failed = next((w for w in process.words().splitlines() if w.startswith(("FAILED", "ERROR"))), "")
                yield Verdict(mutant, outcome, failed[:200], round(process.seconds, 1))


def _copy(stack: contextlib.ExitStack) -> Path:
    folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="mutants-"))).resolve()
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for name in filter(None, listed.split("\0")):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(ROOT / name, folder / name)
    return folder


@dataclass
class _Process:
    """Forked process that runs tests, its log, and its limit of seconds."""

    pid: int
    log: Path
    limit_s: float
    started: float
    cpu_s: float = 0.0
    seconds: float = 0.0

    def code(self) -> int | None:
        """Exit code, negative if the process was ended at a limit, or None if it runs."""
        self.seconds = time.monotonic() - self.started
        late = self.seconds > self.limit_s
        if late:
            os.killpg(self.pid, signal.SIGKILL)
        pid, status, usage = os.wait4(self.pid, 0 if late else os.WNOHANG)
        if not pid:
            return None
        self.cpu_s = usage.ru_utime + usage.ru_stime
        return os.waitstatus_to_exitcode(status)

    def words(self) -> str:
        return self.log.read_text(encoding="utf-8", errors="replace")


def _start(copy: Path, tests: list[str], limits: tuple[float, float] | None, compiled: bool = False) -> _Process:
    """Fork a process that runs the tests in a copy of the project; limits of CPU time and of time, s.

    Numba's cache does not contain the state of called functions: mutants of compiled code start with an empty one.
    """
    log = copy / "mutant.log"
    started = time.monotonic()
    if pid := os.fork():
        return _Process(pid, log, limits[1] if limits else float("inf"), started)
    code = BROKEN
    try:
        os.setsid()
        with log.open("wb") as file:
            os.dup2(file.fileno(), 1)
            os.dup2(file.fileno(), 2)
        if limits:
            resource.setrlimit(resource.RLIMIT_CPU, (int(limits[0]), int(limits[0]) + 5))
        os.chdir(copy)
        cache = copy / (".numba_mutant" if compiled else ".numba")
        if compiled:
            shutil.rmtree(cache, ignore_errors=True)
        os.environ.update(PYTHONPATH=str(copy), NUMBA_CACHE_DIR=str(cache))
        if limits:  # only the run without a mutation stores bytecode
            os.environ["PYTHONDONTWRITEBYTECODE"] = "1"
            sys.dont_write_bytecode = True
        sys.path[:] = [str(copy), *(p for p in sys.path if Path(p).resolve() != ROOT)]
        for name in [n for n, module in list(sys.modules.items()) if _is_project(module, ROOT)]:
            del sys.modules[name]
        code = int(pytest.main([*PYTEST, *tests]))
        if limits is None:
            others = [n for n, module in list(sys.modules.items()) if _is_installed(module)]
            (copy / MODULES).write_text(json.dumps(others), encoding="utf-8")
    except BaseException:
        traceback.print_exc()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


def _is_project(module: Any, root: Path) -> bool:
    return str(getattr(module, "__file__", None) or "").startswith(f"{root}/") and not _is_installed(module)


def _is_installed(module: Any) -> bool:
    return "site-packages" in str(getattr(module, "__file__", None) or "")


if __name__ == "__main__":
    main()
