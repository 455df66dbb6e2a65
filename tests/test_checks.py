"""The hosted checks, `.ci/run` and pre-commit run the same targets of the Makefile, with the same uv."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).parents[1]
MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")
WORKFLOW = ROOT / ".github" / "workflows" / "ci.yml"
HOOKS = ROOT / ".pre-commit-config.yaml"
_PINNED = re.compile(r"[\w.-]+/[\w.-]+@[0-9a-f]{40} # v\d+\.\d+\.\d+")


def jobs() -> dict[str, dict[str, Any]]:
    return yaml.safe_load(WORKFLOW.read_text(encoding="utf-8"))["jobs"]


def made(job: dict[str, Any]) -> set[str]:
    """The targets that the steps of a job make."""
    return {step["run"].removeprefix("make ") for step in job["steps"] if step.get("run", "").startswith("make ")}


def hooks(stage: str) -> list[str]:
    found = yaml.safe_load(HOOKS.read_text(encoding="utf-8"))["repos"]
    return [hook["entry"].split()[-1] for repo in found for hook in repo["hooks"] if hook["stages"] == [stage]]


def is_a_target(name: str) -> bool:
    return re.search(rf"^{name}:", MAKEFILE, re.MULTILINE) is not None


def test_the_hosted_checks_make_what_the_local_ones_make() -> None:
    local = set(re.findall(r"^make (.+)$", (ROOT / ".ci" / "run").read_text(encoding="utf-8"), re.MULTILINE))
    hosted = {target for name, job in jobs().items() if name != "thorough" for target in made(job)}
    assert local <= hosted
    assert all(is_a_target(target) for target in hosted)


def test_tests_and_wheels_run_on_three_systems() -> None:
    for name, target in (("test", "test"), ("wheels", "wheel")):
        job = jobs()[name]
        systems = {system.split("-")[0] for system in job["strategy"]["matrix"]["system"]}
        assert systems == {"ubuntu", "windows", "macos"}
        assert target in made(job)


def test_all_cases_run_at_night() -> None:
    assert made(jobs()["thorough"]) == {"test-thorough"}
    assert "schedule" in jobs()["thorough"]["if"]
    assert re.search(r"^  schedule:$", WORKFLOW.read_text(encoding="utf-8"), re.MULTILINE)


def test_actions_are_pinned_and_uv_has_the_version_of_the_makefile() -> None:
    text = WORKFLOW.read_text(encoding="utf-8")
    assert [use for use in re.findall(r"uses: (.*)", text) if not _PINNED.fullmatch(use)] == []
    wanted = re.search(r"^UV_VERSION := (\S+)$", MAKEFILE, re.MULTILINE)
    assert wanted is not None
    assert re.findall(r'^  UV_VERSION: "([^"]+)"', text, re.MULTILINE) == [wanted[1]]


@pytest.mark.parametrize(
    ("message", "holds"),
    [
        ("A" * 72 + "\n\nWhy.\n", True),
        ("One line\n", True),
        ("One line\n# a comment of git\n", True),
        ("A" * 73 + "\n\nWhy.\n", False),
        ("Subject\nno empty line\n", False),
    ],
)
def test_the_subject_of_a_commit_is_short(message: str, holds: bool) -> None:
    (pattern,) = hooks("commit-msg")
    assert (re.search(pattern, message, re.MULTILINE | re.DOTALL) is None) == holds


def test_types_are_checked_at_a_push_only() -> None:
    assert hooks("pre-commit") == ["format", "layers"]
    assert hooks("pre-push") == ["types"]
    assert all(is_a_target(target) for target in ("format", "layers", "types"))
