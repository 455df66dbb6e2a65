"""An item made for a test: its claims, its files, and that its figures have something on them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

from reproduction.catalogue import chosen
from reproduction.files import Written
from reproduction.running import reproduce


def made(number: str, folder: Path) -> Written:
    """One item, in this process."""
    (found,) = reproduce(chosen([number]), folder)
    for panel in found.record["panels"]:
        assert (found.folder / f"{panel['name']}.svg").stat().st_size > 2000
        assert panel["description"].endswith(".")
    for table in found.record["tables"]:
        rows = pq.read_table(found.folder / f"{table['name']}.parquet")
        assert rows.num_rows > 0
        assert rows.column_names == table["columns"]
    assert found.claims
    return found


def verdicts(found: Written) -> Mapping[str, str]:
    """Statement to verdict."""
    return {claim["statement"]: claim["verdict"] for claim in found.claims}


def column(found: Written, table: str, name: str) -> np.ndarray:
    """A column of one of its tables."""
    return pq.read_table(found.folder / f"{table}.parquet")[name].to_numpy()
