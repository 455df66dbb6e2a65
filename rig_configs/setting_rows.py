"""What the settings of a driver are, from its models: name, default, permitted values, meaning."""

from __future__ import annotations

import inspect
import json
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, get_args

from rig_configs.device import DeviceSettings, DisplacementTable, RotorNodeSettings, SampledTable
from rig_configs.table import RigTable

COMMON: Mapping[str, type[RigTable]] = {
    "Every device": DeviceSettings,
    "Every displacement sensor": DisplacementTable,
    "Displacement sensors with a rate": SampledTable,
    "Every encoder node": RotorNodeSettings,
}
"""Models of settings that several drivers share, by title."""
_ENTRY = re.compile(r"^    (\w[\w, ]*):(.*(?:\n {8}.*)*)", re.MULTILINE)
_BOUNDS = {"exclusiveMinimum": ">", "minimum": "≥", "exclusiveMaximum": "<", "maximum": "≤"}
_WORDS = {"boolean": "true, false", "object": "table", "string": "text", "integer": "whole number"}


@dataclass(frozen=True)
class SettingRow:
    """Settings with one meaning.

    Attributes:
        names: their names.
        default: their default, or one for each; "required" without one.
        permitted: values that they may have.
        meaning: what they mean, with the unit; empty if the docstrings do not state it.
    """

    names: tuple[str, ...]
    default: str
    permitted: str
    meaning: str


def rows_of(model: type[RigTable], known: Iterable[str] = ()) -> list[SettingRow]:
    """Return the settings of a model without those that are known."""
    texts, without = _meanings(model), set(known)
    groups: dict[tuple[str, str], dict[str, str]] = {}  # defaults by name, of settings with one meaning
    for name, schema in model.model_json_schema()["properties"].items():
        if name in without:
            continue
        default = "required" if model.model_fields[name].is_required() else _default(schema.get("default"))
        groups.setdefault((_permitted(schema), texts.get(name, "")), {})[name] = default
    return [
        SettingRow(tuple(names), ", ".join(_together(names.values())), values, meaning)
        for (values, meaning), names in groups.items()
    ]


def tables_inside(model: type[RigTable], known: Iterable[str] = ()) -> dict[str, list[SettingRow]]:
    """Return the settings of the tables inside a model, by the names of the models that have the same."""
    found: dict[tuple[SettingRow, ...], list[str]] = {}
    for part in dict.fromkeys(_models_in(model)):
        found.setdefault(tuple(rows_of(part, known)), []).append(part.__name__)
    return {" or ".join(names): list(rows) for rows, names in found.items() if rows and names[0] != model.__name__}


def _meanings(model: type[RigTable]) -> dict[str, str]:
    """Return what each setting means, from the docstrings of the model and of those that it extends."""
    found: dict[str, str] = {}
    for base in reversed(model.__mro__):
        section = (inspect.cleandoc(base.__doc__ or "") + "\n").partition("Attributes:\n")[2]
        for names, text in _ENTRY.findall(section.split("\n\n")[0]):
            found |= dict.fromkeys(names.split(", "), " ".join(text.split()))
    return found


def _permitted(schema: Mapping[str, Any]) -> str:
    """Return the values that a setting may have, from its JSON schema."""
    if "anyOf" in schema:
        return " or ".join(dict.fromkeys(_permitted(each) for each in schema["anyOf"] if each.get("type") != "null"))
    if "enum" in schema or "const" in schema:
        return ", ".join(map(_literal, schema.get("enum", [schema.get("const")])))
    if "$ref" in schema:
        return "table"
    if schema.get("type") == "array":
        return f"list of {_permitted(schema.get('items', {})) or 'values'}"
    bounds = " ".join(f"{sign} {schema[key]}" for key, sign in _BOUNDS.items() if key in schema)
    kind = ("" if bounds else "number") if schema.get("type") == "number" else _WORDS.get(schema.get("type", ""), "")
    return " ".join(part for part in (kind, bounds) if part)


def _models_in(model: type[RigTable]) -> Iterator[type[RigTable]]:
    """Yield a model and the models of the tables inside it."""
    yield model
    for field in model.model_fields.values():
        for part in _types_in(field.annotation):
            yield from _models_in(part)


def _types_in(annotation: Any) -> Iterable[type[RigTable]]:
    if isinstance(annotation, type) and issubclass(annotation, RigTable):
        return [annotation]
    return [found for part in get_args(annotation) for found in _types_in(part)]


def _together(defaults: Iterable[str]) -> list[str]:
    """Return the default that all have, or else one for each."""
    found = list(defaults)
    return found[:1] if len(set(found)) == 1 else [each or "–" for each in found]


def _default(value: Any) -> str:
    return "" if value is None or isinstance(value, dict) else _literal(value)


def _literal(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False)
