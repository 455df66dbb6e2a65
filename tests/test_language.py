"""The words that docs/contributing/language.md rejects are in no name, comment, docstring, message, page or help text.

Packages, tests, benchmarks, examples, the pages of the root and of the docs, and the help of all commands are checked.
Pages and help texts contain no words in capitals for emphasis.
"""

from __future__ import annotations

import ast
import re
import tokenize
from collections import Counter
from functools import cache
from pathlib import Path

import pytest

from rig_cli.main import commands

ROOT = Path(__file__).parents[1]
GUIDE = ROOT / "docs/contributing/language.md"
PACKAGES = sorted(path.parent.name for path in ROOT.glob("*/py.typed"))
FOLDERS = ("tests", "benchmarks", "examples")
REJECTED = {
    "tell": r"(?<![a-z])(tell|tells|told|telling)(?![a-z])",
    "say": r"(?<![a-z])(says|said|say|saying)(?![a-z])",
    "know": r"(?<![a-z])(knows|knew)(?![a-z])",
    "forget": r"\b(forgets?|forgot|forgotten|remembers?)\b",
    "hang": r"\bhangs? on\b",
    "believe": r"\bbeliev(es?|ed)\b",
    "is none": r"(?<!there )\b(is|are|was|were) none\b",
    "is no": r"(?<!there )\bis no (log|number)\b",
    "nobody": r"\b(nobody|somebody|anybody|whoever|whatever)\b",
    "anew": r"\b(anew|beside|hitherto|aught)\b",
    "wild": r"(?<![a-z])wild(?![a-z])",
    "let go": r"\b(lets?|letting) go\b",
}
RULE = re.compile("|".join(f"(?:{pattern})" for pattern in REJECTED.values()))
# The first letter of a sentence and words in capitals; the None of Python is no word.
CAPITAL = re.compile(r"\b(?!None\b)[A-Z]+(?=[a-z]|\b)")
# Modules that contain the words: this one by its task; one whose text is still to be revised.
OPEN_MODULES = {"tests/test_language.py", "benchmarks/mutants.py"}
# The name of a module that pages and the changelog mention.
MODULE_NAMES = {"believed_figures"}
# Methods of every file object of Python.
FILE_METHODS = {"tell"}
# Keys in results and logs, kept for the programs that read them.
KEYS_IN_FILES = {"believed", "beside", "anew", "told_range_m", "told_rpm"}
# `python -m MODULE` and `ls -l` are no options of this suite.
OPTION = re.compile(r"(^|[\s`'(])--[a-z]|\w[\w.,;]* -(?!m |l )[a-z](?=[\s`'.,;:)]|$)")
STARTS_COMMANDS = ("fresh_process.py", "library_peers.py")  # their texts are commands
KINDS = {tokenize.NAME, tokenize.COMMENT, tokenize.STRING, getattr(tokenize, "FSTRING_MIDDLE", tokenize.STRING)}
CODE = re.compile(r"`+[^`]+`+|^\s*\w+(?:, \w+)*:|\b\w+(?:\.\w+)+|\{[^{}]*\}", re.ASCII)
FENCED = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)
# A word in capitals that is no part of a designation, a key or a command: KEY=VALUE, XB-24, AT/AP, A.B
SHOUTED = re.compile(r"(?<![\w=./:{<|-])[A-Z]{2,}(?![\w=:/}>|]|-\w|\.\w)")
LOWER = re.compile(r"(?<![\w.-])[a-z]{2,}(?![\w-])")
PLACEHOLDER = re.compile(r"(?<!\w)[A-Z]{2,}(?=[=:…])|(?<=:)[A-Z]{2,}|(?<=--)[a-z-]+ ([A-Z]{2,})")
# Names in capitals whose letters are also an ordinary word: the modems' command set, the bus, the variable of the
# shell, the button of the live page. All other such names (states, outputs of a sensor) stand in code marks.
NAMES = {"AT", "CAN", "PATH", "STOP"}
# A word on so many pages in small letters is an ordinary word, and no abbreviation (csv, mcap).
ORDINARY_PAGES = 3


def pages() -> list[Path]:
    found = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]
    return [page for page in found if page != GUIDE]


@cache
def help_texts() -> str:
    """The help of all commands, as in docs/commands.md."""
    names = [name for name in commands() if not name.startswith("-")]
    return commands(names).generate_docs(output_format="markdown")


def prose(text: str) -> list[tuple[int, str]]:
    """Numbered lines of a page or a help text, without code."""
    text = FENCED.sub(lambda code: "\n" * code[0].count("\n"), text)
    lines = enumerate(text.splitlines(), 1)
    return [(number, CODE.sub("", line)) for number, line in lines if not line.startswith("    ")]


def ordinary_words() -> set[str]:
    """Words in small letters on several pages."""
    found = [{w for _, line in prose(page.read_text("utf-8")) for w in LOWER.findall(line)} for page in pages()]
    counts = Counter(word for words in found for word in words)
    return {word for word, count in counts.items() if count >= ORDINARY_PAGES}


def shouted(text: str, ordinary: set[str], names: set[str]) -> list[str]:
    """Lines of a page or a help text that contain an ordinary word in capitals."""
    return [
        f"{number}: {word}: {line.strip()[:100]}"
        for number, line in prose(text)
        for word in SHOUTED.findall(line)
        if word.lower() in ordinary and word not in names
    ]


def placeholders(text: str) -> set[str]:
    """Words of a help text that stand for a value: those in code marks, and KEY in KEY=VALUE or --option KEY."""
    marked = {word for code in re.findall(r"`([^`]+)`", text) for word in re.findall(r"[A-Z]{2,}", code)}
    return marked | {found[1] or found[0] for found in PLACEHOLDER.finditer(text)}


def rejected(path: Path) -> list[str]:
    """Lines of a file with a rejected word; of a module the names, comments and texts in it."""
    if path.suffix == ".md":
        parts = list(enumerate(path.read_text(encoding="utf-8").splitlines(), 1))
    else:
        with path.open("rb") as file:
            tokens = [token for token in tokenize.tokenize(file.readline) if token.type in KINDS]
        parts = [(t.start[0] + i, line) for t in tokens for i, line in enumerate(t.string.splitlines())]
    allowed = FILE_METHODS | KEYS_IN_FILES | MODULE_NAMES
    hits = [(n, text) for n, text in parts if text.strip("\"'") not in allowed and RULE.search(_words(text))]
    return [f"{path.relative_to(ROOT)}:{number}: {text.strip()[:100]}" for number, text in hits]


def _words(text: str) -> str:
    """Text without code and capitals, or the words of a name."""
    prose = text.replace("_", " ") if text.isidentifier() else CODE.sub("", text)
    return CAPITAL.sub(lambda letter: letter[0].lower(), prose)


def test_the_packages_are_found() -> None:
    assert {"daq", "identification", "analysis", "dynamics", "rig_cli"} <= set(PACKAGES)


@pytest.mark.parametrize("package", PACKAGES)
def test_no_module_uses_a_rejected_word(package: str) -> None:
    assert [hit for path in sorted((ROOT / package).rglob("*.py")) for hit in rejected(path)] == []


def options_in_texts(source: str) -> list[str]:
    """Texts of a module that name an option of a command line; docstrings are not among them."""
    tree = ast.parse(source)
    docstrings = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    texts = [n for n in ast.walk(tree) if isinstance(n, ast.Constant) and isinstance(n.value, str)]
    return sorted(f"{n.lineno}: {n.value}" for n in texts if id(n) not in docstrings and OPTION.search(n.value))


@pytest.mark.parametrize("package", [package for package in PACKAGES if package != "rig_cli"])
def test_no_message_of_a_library_names_an_option(package: str) -> None:
    """A script or a page that uses the package has no options; the command line adds them itself."""
    modules = (path for path in sorted((ROOT / package).rglob("*.py")) if path.name not in STARTS_COMMANDS)
    found = {str(path): options_in_texts(path.read_text(encoding="utf-8")) for path in modules}
    assert {path: texts for path, texts in found.items() if texts} == {}


def test_an_option_in_a_message_is_found() -> None:
    source = 'def f():\n    "--json is fine here"\n    raise ValueError(f"{f}: no --json", "a -- b", "--x", "---")\n'
    assert options_in_texts(source) == ["3: --x", "3: : no --json"]
    source = 'g("use -o for it", "a name with -o", "x - y", "x -1", "run python -m a.b", "list it (ls -l a)", "-y")'
    assert options_in_texts(source) == ["1: a name with -o", "1: use -o for it"]


@pytest.mark.parametrize("folder", FOLDERS)
def test_no_test_benchmark_or_example_uses_a_rejected_word(folder: str) -> None:
    modules = [path for path in sorted((ROOT / folder).rglob("*.py")) if _revised(path)]
    assert len(modules) > 2
    assert [hit for path in modules for hit in rejected(path)] == []


def _revised(module: Path) -> bool:
    return module.relative_to(ROOT).as_posix() not in OPEN_MODULES


def test_no_page_uses_a_rejected_word() -> None:
    assert [hit for page in pages() for hit in rejected(page)] == []


def test_no_help_text_uses_a_rejected_word() -> None:
    assert all(f"# rig {name}" in help_texts() for name in ("demo", "identify", "virtual pluck"))
    assert [line for line in help_texts().splitlines() if RULE.search(_words(line))] == []


def test_no_page_has_a_word_in_capitals_for_emphasis() -> None:
    ordinary = ordinary_words()
    found = {page.relative_to(ROOT).as_posix(): shouted(page.read_text("utf-8"), ordinary, NAMES) for page in pages()}
    assert {page: lines for page, lines in found.items() if lines} == {}


def test_no_help_text_has_a_word_in_capitals_for_emphasis() -> None:
    assert shouted(help_texts(), ordinary_words(), NAMES | placeholders(help_texts())) == []


def test_a_word_in_capitals_is_found_and_a_name_is_not() -> None:
    ordinary = {"not", "the", "name", "key", "free"}
    text = "This is NOT a MCAP of THE bus.\n\n```\nNOT code\n```\n    NOT code\n`NOT` CAN-NOT KEY=NAME, state FREE\n"
    assert [line.split(":")[1].strip() for line in shouted(text, ordinary, {"FREE"})] == ["NOT", "THE"]
    assert placeholders("give KEY=VALUE or `NAME`, --level LEVEL, NOT that") == {"KEY", "NAME", "LEVEL"}


def test_a_rejected_word_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.test_language.ROOT", tmp_path)
    module = tmp_path / "module.py"
    module.write_text(
        '"""What it says."""\n\nwhoever = []  # a wild one\nknown = "asked for"\n'
        'def test_what_is_no_log(a, b):\n    """Nobody reads it; `b` is None."""\n    return f"{a} is told {b}"\n'
        'STATE = "LET GO"\n'
    )
    lines = [int(hit.split(":")[1]) for hit in rejected(module)]
    assert lines == [1, 3, 3, 5, 6, 7, 8]


def test_the_guide_names_every_rejected_word() -> None:
    table = GUIDE.read_text(encoding="utf-8").split("## Words that are rejected")[1]
    assert [name for name in REJECTED if not re.search(rf"\b{name}s?\b", table)] == []
