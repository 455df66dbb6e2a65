"""Labels of shared errors: text, fields, files, and the budget's type of evaluation as the texts had it before."""

from __future__ import annotations

import re
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from hypothesis import example, given, strategies as st

from rig_configs import ErrorLabel, IdentifiedParameters
from rig_configs.error_label import Kind
from rig_configs.shared_errors import shared_source

KINDS = tuple(kind for kind in get_args(Kind) if kind != "other")
WORDS = st.text(max_size=6) | st.sampled_from(["", "laser_x", "laser x", "in", " in ", "a in b", "1", "drag 1"])
TEXTS = WORDS | st.builds("{}{}{}{}".format, st.sampled_from(KINDS), st.sampled_from(["", " ", "  "]), WORDS, WORDS)


@pytest.mark.parametrize(
    ("text", "fields"),
    [
        ("gain x", ("gain", "x", "")),
        ("clock laser_x", ("clock", "laser_x", "")),
        ("clock laser_x in 04-run-up.mcap", ("clock", "laser_x", "04-run-up.mcap")),
        ("clock my laser in 1.mcap + 2 in lab.mcap", ("clock", "my laser", "1.mcap + 2 in lab.mcap")),
        ("known rotor.mass_kg", ("known", "rotor.mass_kg", "")),
        ("known scale in the lab", ("known", "scale in the lab", "")),
        ("friction 1", ("friction", "1", "")),
        ("friction drag 1", ("friction", "drag 1", "")),
        ("suspension hardening1_per_m2", ("suspension", "hardening1_per_m2", "")),
        ("slow roll 1", ("slow roll", "1", "")),
        ("axis angle", ("axis angle", "", "")),
        ("clock", ("clock", "", "")),
        ("lever x", ("other", "lever x", "")),
        ("clocks x", ("other", "clocks x", "")),
        ("gain ", ("other", "gain ", "")),
        ("", ("other", "", "")),
    ],
)
def test_a_text_has_these_fields(text: str, fields: tuple[Kind, str, str]) -> None:
    found = ErrorLabel.read(text)
    assert (found.kind, found.of, found.log) == fields
    assert (found, found.text) == (ErrorLabel(*fields), text)


@given(TEXTS)
@example("clock  in a")
@example("clock a in ")
@example("clock a in b in c")
def test_every_text_is_kept(text: str) -> None:
    assert ErrorLabel.read(text).text == text


@given(st.sampled_from(get_args(Kind)), WORDS, WORDS)
def test_labels_are_equal_if_their_texts_are(kind: Kind, of: str, log: str) -> None:
    label = ErrorLabel(kind, of, log)
    found = ErrorLabel.read(label.text)
    assert (found, hash(found), found.text) == (label, hash(label), label.text)
    assert not label < found


@given(WORDS.filter(lambda word: "\n" not in word), st.sampled_from(KINDS))
def test_the_type_of_evaluation_is_that_of_the_text(word: str, kind: str) -> None:
    text = f"{kind} {word}"
    is_statistical = text.startswith(("friction ", "suspension ")) or re.match(r"clock \S.* in .", text)
    assert shared_source(ErrorLabel.read(text)).kind == ("A" if is_statistical and word else "B")


@pytest.mark.parametrize("text", ["gain x", "clock east in 1.mcap + 2.mcap", "known my balance", "lever x"])
def test_a_file_is_kept_byte_for_byte(text: str, tmp_path: Path) -> None:
    label, first, second = ErrorLabel.read(text), tmp_path / "first.toml", tmp_path / "second.toml"
    shift = np.array([0.5])
    IdentifiedParameters({"k1_N_per_m": 2600.0}, np.array([[1.0]]), shared={label: shift}).save(first)
    assert f'\n[shared]\n"{text}" = [0.5]\n' in first.read_text(encoding="utf-8")
    again = IdentifiedParameters.load(first)
    assert list(again.shared) == [label]
    again.save(second)
    assert second.read_bytes() == first.read_bytes()
