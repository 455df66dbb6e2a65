"""A picture comes out as it went in."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from live.frames import decode, encode

NAMES = st.text(st.characters(codec="utf-8"), min_size=1, max_size=12).filter(lambda name: name != "columns")
COLUMNS = st.dictionaries(NAMES, st.lists(st.floats(width=32), max_size=50), max_size=6)
FACTS = st.dictionaries(
    NAMES, st.none() | st.booleans() | st.integers(-(2**40), 2**40) | st.text(max_size=20), max_size=6
)


@given(FACTS, COLUMNS)
def test_header_and_columns_come_back(facts: dict[str, object], columns: dict[str, list[float]]) -> None:
    data = encode(facts, {name: np.array(values) for name, values in columns.items()})
    assert len(data) % 4 == 0
    header, found = decode(data)
    assert header == facts
    assert list(found) == list(columns)
    for name, values in columns.items():
        np.testing.assert_array_equal(found[name], np.array(values, np.float32))


@pytest.mark.parametrize("data", [b"", b"RIG1", b"RIG2" + bytes(8), encode({}, {"x": np.zeros(3)})[:-4]])
def test_what_is_cut_or_none_is_refused(data: bytes) -> None:
    with pytest.raises(ValueError, match="expected"):
        decode(data)
