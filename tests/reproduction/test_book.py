"""The book and the command: what is in them, what is refused, the same from several processes."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from reproduction.book import write_book, write_docs
from reproduction.catalogue import ITEMS, PAGES, chosen
from reproduction.errors import UnknownItem
from reproduction.items import rotor_alone
from reproduction.running import reproduce
from rig_cli.main import run


def test_numbers_choose_items() -> None:
    assert [item.id for item in chosen(["2.2"])] == ["2.2"]
    assert [item.id for item in chosen(["2"])] == ["2.2", "2.3"]
    assert chosen([]) == list(ITEMS)
    with pytest.raises(UnknownItem, match=r"no item '2\.9' of the source; known: 2\.2, 2\.3"):
        chosen(["2.9"])
    assert len({item.id for item in ITEMS}) == len(ITEMS)


@pytest.mark.parametrize("item", ITEMS, ids=lambda item: item.id)
def test_every_item_has_a_function(item) -> None:
    assert callable(item.make())


def test_the_book_has_figures_claims_and_what_does_not_hold(tmp_path: Path) -> None:
    made = reproduce(chosen(["2"]), tmp_path)
    text = write_book(tmp_path / "book.html", made).read_text(encoding="utf-8")
    assert text.count("<svg") == 2
    assert text.index("Claims that do not hold") < text.index("2.2 · ")
    assert "above resonance the printed form is 180° off" in text
    assert "http" not in text.replace("http://www.w3.org", ""), "nothing is fetched"
    write_docs(tmp_path / "docs", made)
    page = (tmp_path / "docs" / "rotor_alone.md").read_text(encoding="utf-8")
    assert "(figures/2.2-response.png)" in page
    assert "| (2-9) | The lag is the arc tangent" in page
    small, whole = (tmp_path / name for name in ("docs/figures/2.2-response.png", "2.2/response.png"))
    assert 3000 < small.stat().st_size < whole.stat().st_size
    overview = (tmp_path / "docs" / "index.md").read_text(encoding="utf-8")
    assert "| [2.2](rotor_alone.md) | (2-9) |" in overview
    assert "7 claims: holds 6, does not hold 1." in overview


def test_the_command_writes_the_same_from_two_processes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for jobs in ("1", "2"):
        assert run(["reproduce", "2", "-o", str(tmp_path / jobs), "--jobs", jobs, "--json"]) == 0
        result = json.loads(capsys.readouterr().out)
        assert [one["id"] for one in result["items"]] == ["2.2", "2.3"]
        assert result["verdicts"]["does not hold"] == 1
    for name in ("2.2/response.parquet", "2.2/response.svg", "2.3/forces.inline.svg"):
        assert (tmp_path / "1" / name).read_bytes() == (tmp_path / "2" / name).read_bytes()


def test_an_item_that_fails_leaves_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken(work: object) -> None:
        raise ZeroDivisionError("no such speed")

    monkeypatch.setattr(rotor_alone, "forces_2_3", broken)
    assert run(["reproduce", "2", "-o", str(tmp_path), "--jobs", "1"]) == 3
    assert "2.3 could not be reproduced: ZeroDivisionError: no such speed" in capsys.readouterr().err
    text = (tmp_path / "book.html").read_text(encoding="utf-8")
    assert text.count("<svg") == 1
    assert "not made</span> ZeroDivisionError: no such speed" in text


def test_the_pages_of_the_docs_have_every_item() -> None:
    book = Path(__file__).parents[2] / "docs" / "book"
    text = "".join((book / f"{page.name}.md").read_text(encoding="utf-8") for page in PAGES)
    headings = re.findall(r"^## (.*)", text, re.MULTILINE)
    assert headings == [f"{item.id}: {item.title}" for item in ITEMS], "rig reproduce --all --docs docs/book"
    assert "Not reproduced" not in text
    shown = re.findall(r"\]\((figures/[^)]+)\)", text)
    assert len(shown) >= len(ITEMS)
    assert {book / name for name in shown} == set((book / "figures").iterdir())


def test_the_command_refuses_and_lists(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["reproduce"]) == 2
    assert "--list shows them" in capsys.readouterr().err
    assert run(["reproduce", "9.9"]) == 2
    assert "no item '9.9' of the source" in capsys.readouterr().err
    assert run(["reproduce", "--list"]) == 0
    assert "2.2        Amplification and phase lag" in capsys.readouterr().out
