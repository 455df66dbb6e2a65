"""Losses of a log before it was recovered: stored in the recovered log, so that it is not taken for a complete one."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterable, Mapping
from dataclasses import asdict, replace
from functools import lru_cache

import pydantic

from daq.mcap.missing import Missing
from rig_basics.texts import number_of

_log = logging.getLogger(__name__)

RECOVERED = "recovered"
"""Name of the metadata record that states the source of a recovered log."""
_PLACES, _SENTENCES = "places", "missing"
_MOST_PLACES = 10_000
_BEFORE = "lost before it was recovered: "


def lost_metadata(lost: Iterable[Missing], origin: str, earlier: Iterable[Missing]) -> dict[str, str]:
    """Return the metadata texts of a recovered log that describe its losses.

    Args:
        lost: what the source file lacked; byte positions refer to the source file.
        origin: name of the source file.
        earlier: what had been lost before the source file itself was recovered.
    """
    lost = list(lost)
    places = _shortened([*earlier, *(_of_origin(place, origin) for place in lost)])
    sentences = map(str, _shortened(lost))
    return {_SENTENCES: "\n".join(sentences), _PLACES: json.dumps([asdict(place) for place in places])}


def read_lost(metadata: Mapping[str, Mapping[str, str]]) -> tuple[Missing, ...]:
    """Return what was lost before a log was recovered, from its metadata; empty for any other log."""
    record = metadata.get(RECOVERED, {})
    return _parsed(record.get(_PLACES, ""), record.get(_SENTENCES, ""))


def _shortened(places: list[Missing]) -> list[Missing]:
    """Limit the number of places to what a metadata record holds; the last ones are combined into one."""
    if len(places) <= _MOST_PLACES:
        return places
    others = places[_MOST_PLACES - 1 :]
    starts, ends = [place.start_ns for place in others], [place.end_ns for place in others]
    counts = [place.messages for place in others]
    together = Missing(
        number_of(len(others), "more place"),
        start_ns=None if None in starts else min(start for start in starts if start is not None),
        end_ns=None if None in ends else max(end for end in ends if end is not None),
        topics=tuple(sorted({topic for place in others for topic in place.topics})),
        messages=None if None in counts else sum(count for count in counts if count is not None),
    )
    return [*places[: _MOST_PLACES - 1], together]


def _of_origin(place: Missing, origin: str) -> Missing:
    where = ""
    if place.byte_start is not None:
        end = "on" if place.byte_end is None else f"to {place.byte_end}"
        where = f"from byte {place.byte_start} {end} of {origin}: "
    return replace(place, text=f"{_BEFORE}{where}{place.text}", byte_start=None, byte_end=None)


@lru_cache(maxsize=64)
def _parsed(places: str, sentences: str) -> tuple[Missing, ...]:
    """Parse the stored places; if they are not a valid list, use the sentences."""
    if not places:
        return tuple(Missing(_BEFORE + line) for line in sentences.splitlines())
    try:
        return pydantic.TypeAdapter(tuple[Missing, ...]).validate_json(places)
    except pydantic.ValidationError as fault:
        _log.info("the places of lost data in a recovered log are invalid, its sentences are used: %s", fault)
        return tuple(Missing(_BEFORE + line) for line in sentences.splitlines() or ["what, cannot be read any more"])
