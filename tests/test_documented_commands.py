"""Every `rig …` command that the pages show is accepted by the program's own command line; none is carried out here.

`tests.run_documented_commands` carries out those of blocks on the files of a demo; its judgement is tested here.

A command in a block is complete. One within a sentence may lack arguments, or have a word in capitals in place of one.
"""

from __future__ import annotations

import json
import re
import shlex
import signal
import sys
from pathlib import Path

import pytest
from cyclopts import CoercionError, CycloptsError, MissingArgumentError

from rig_cli.main import commands, split_log_level

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = sorted({*ROOT.glob("*.md"), *DOCS.rglob("*.md"), *DOCS.rglob("*.ipynb")})
FENCED = re.compile(r"^ *```([^\n]*)\n(.*?)^ *```", re.MULTILINE | re.DOTALL)
# Prompt, variables and the program that starts the command, which may stand before it.
BEGINS = r"(?:\$ )?(?:[A-Z_]+=\S+ )*(?:uv run (?:--no-sync )?|uvx --from \S+ |nohup )?"
SHOWN = re.compile(rf"^ *{BEGINS}(rig .*)$")
INLINE = re.compile(r"(?<!`)`(?:uv run (?:--no-sync )?)?(rig [a-z-][^`]*)`(?!`)")
PLACEHOLDER = re.compile(r"\b[A-Z]+\b")
LEFT_OUT = "…"
NEW_IN_AN_EXAMPLE = "rig plot radius "  # the kind of plot that a how-to makes
TRACEBACK = "Traceback (most recent call last):\n"


def text_of(page: Path) -> str:
    """A page's text; of a notebook that of its texts."""
    text = page.read_text(encoding="utf-8")
    if page.suffix == ".md":
        return text
    return "\n\n".join("".join(cell["source"]) for cell in json.loads(text)["cells"] if cell["cell_type"] == "markdown")


def in_blocks(text: str) -> list[str]:
    """Commands in fenced and indented blocks, each on one line."""
    blocks = [code for kind, code in FENCED.findall(text) if not kind.startswith(("py", "{", "toml"))]
    indented = [line for line in joined(FENCED.sub("", text)) if line.startswith("    ")]
    lines = [*(line for block in blocks for line in joined(block)), *indented]
    shown = [found[1] for line in lines if (found := SHOWN.match(line))]
    return [command for command in shown if not command.startswith(NEW_IN_AN_EXAMPLE)]


def joined(text: str) -> list[str]:
    """Lines of a text, with those that a backslash continues."""
    return re.sub(r"\\\n\s*", "", text).splitlines()


def in_sentences(text: str) -> list[str]:
    """Commands within the sentences and tables of a page."""
    return [re.sub(r"\s+", " ", command).replace("\\|", "|") for command in INLINE.findall(FENCED.sub("", text))]


def words_of(command: str) -> list[str]:
    """Words after `rig`, without comment, redirection and what is left out."""
    words = shlex.split(command, comments=True)[1:]
    end = next((i for i, word in enumerate(words) if word in {">", "|", "&&", "&", "<"}), len(words))
    kept = [word for word in words[:end] if word != LEFT_OUT]
    return split_log_level(kept)[0]


def fault_of(command: str, complete: bool) -> str:
    """What the command line refuses in a command; empty if it accepts it."""
    words = words_of(command)
    if not complete and "".join(words[:1]).isupper():
        return ""
    try:
        commands(words).parse_args(words, exit_on_error=False, print_error=False)
    except MissingArgumentError as error:
        return f"{command}: {error}" if complete else ""
    except CoercionError as error:
        return f"{command}: {error}" if complete or not PLACEHOLDER.search(command) else ""
    except CycloptsError as error:
        return f"{command}: {error}"
    return ""


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_the_commands_of_a_page_are_accepted(page: Path) -> None:
    text = text_of(page)
    faults = [fault_of(each, True) for each in in_blocks(text)] + [fault_of(each, False) for each in in_sentences(text)]
    assert [fault for fault in faults if fault] == []


def test_commands_are_found_on_the_pages_that_show_them() -> None:
    blocks = {page.relative_to(ROOT).as_posix(): len(in_blocks(text_of(page))) for page in PAGES}
    shown = [page for page, count in blocks.items() if count]
    assert {"docs/index.md", "docs/how-to/operator/run_a_campaign.md", "docs/how-to/install.md"} <= set(shown)
    assert sum(blocks.values()) > 100
    assert sum(len(in_sentences(text_of(page))) for page in PAGES) > 100


def test_a_command_that_is_refused_is_found() -> None:
    text = (
        "`rig plot KIND LOG`, `rig export --channel x` and `rig dance`\n\n"
        "    rig map my.toml --x a \\\n        --colour   # a comment\n    rig predict\n\n"
        "```\n$ rig log run.mcap --plot a.svg > b\nX=1 uv run rig test my.toml point A …\n```\n"
        "```python\nrig = 1\nrig .x\n```\n"
    )
    assert in_blocks(text) == [
        "rig log run.mcap --plot a.svg > b",
        "rig test my.toml point A …",
        "rig map my.toml --x a --colour   # a comment",
        "rig predict",
    ]
    assert [bool(fault_of(each, True)) for each in in_blocks(text)] == [False, False, True, True]
    assert [bool(fault_of(each, False)) for each in in_sentences(text)] == [False, True, True]


@pytest.mark.parametrize(
    ("code", "interrupted", "text", "stated", "right"),
    [
        (0, False, "", 0, True),
        (1, False, "", 0, False),
        (3, False, "", 3, True),
        (0, False, "", 3, False),
        (130, True, "rig: interrupted", 0, True),
        (0, True, "", 0, True),
        (130, False, "rig: interrupted", 0, False),
        (2, True, "", 0, False),
        (70, True, "", 0, False),
        (-11, True, "", 0, False),
        (None, True, "", 0, False),
        (0, False, TRACEBACK, 0, False),
        (130, True, f"rig: interrupted\n{TRACEBACK}", 0, False),
    ],
)
def test_the_end_of_a_command_is_judged(
    code: int | None, interrupted: bool, text: str, stated: int, right: bool
) -> None:
    from tests.run_documented_commands import Ended, fault_of  # it imports this module

    assert (fault_of(Ended(code, interrupted, text), {stated}) == "") is right


def test_a_page_states_the_code_that_a_command_ends_with() -> None:
    from tests.run_documented_commands import expected_of

    assert expected_of("rig check my.toml   # exit 3") == {3}
    assert expected_of("rig log run.mcap   # a verdict; exit 3 when one fails") == {0}


def test_commands_at_prompts_belong_to_the_one_that_prompts() -> None:
    from tests.run_documented_commands import AT_A_PROMPT, with_answers

    page = "    rig test my.toml spin-down\n        rig virtual flick\n    rig virtual stop\n"
    answers = set(AT_A_PROMPT.findall(page))
    assert with_answers(in_blocks(page), answers) == [
        ("rig test my.toml spin-down", ["rig virtual flick"]),
        ("rig virtual stop", []),
    ]


@pytest.mark.skipif(sys.platform == "win32", reason="groups of processes and a shell")
def test_a_command_that_does_not_end_is_interrupted(tmp_path: Path) -> None:
    from tests.run_documented_commands import Ended, Started

    assert Started("expr 1 + 1 > kept", tmp_path).ended(60.0) == Ended(0, False, "")
    assert (tmp_path / "kept").read_text() == "2\n"
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # the tests may run with an ignored Ctrl-C
    try:
        assert Started("sleep 600", tmp_path).ended(0.1) == Ended(-signal.SIGINT, True, "")
    finally:
        signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize("command", ["rig virtual --rigg x", "rig parameters dif a b", "rig test my.toml a b c"])
def test_unknown_options_and_words_are_refused(command: str) -> None:
    assert fault_of(command, False)
