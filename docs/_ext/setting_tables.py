"""Tables of the settings of all drivers, made from their models: name, default, permitted values, meaning."""

from __future__ import annotations

import inspect
import json
import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from rig_configs.device import DeviceSettings, DisplacementTable, RotorNodeSettings, SampledTable
from rig_configs.drivers import installed, settings_of
from rig_configs.table import RigTable

# Comment on the page docs/reference/drivers.md that is replaced by the tables.
MARK = "% The settings of every driver are listed here."
COMMON: Mapping[str, type[RigTable]] = {
    "Every device": DeviceSettings,
    "Every displacement sensor": DisplacementTable,
    "Displacement sensors with a rate": SampledTable,
    "Every encoder node": RotorNodeSettings,
}
_ENTRY = re.compile(r"^    (\w[\w, ]*):(.*(?:\n {8}.*)*)", re.MULTILINE)
_BOUNDS = {"exclusiveMinimum": ">", "minimum": "≥", "exclusiveMaximum": "<", "maximum": "≤"}


def meanings(model: type[RigTable]) -> dict[str, str]:
    """Return what each setting means, from the docstrings of the model and of those that it extends."""
    found: dict[str, str] = {}
    for base in reversed(model.__mro__):
        section = (inspect.cleandoc(base.__doc__ or "") + "\n").partition("Attributes:\n")[2]
        for names, text in _ENTRY.findall(section.split("\n\n")[0]):
            found |= dict.fromkeys(names.split(", "), " ".join(text.split()))
    return found


def permitted(schema: Mapping[str, Any]) -> str:
    """Return the values that a setting may have, from its JSON schema."""
    if "anyOf" in schema:
        return " or ".join(dict.fromkeys(permitted(each) for each in schema["anyOf"] if each.get("type") != "null"))
    if "enum" in schema or "const" in schema:
        return ", ".join(map(_literal, schema.get("enum", [schema.get("const")])))
    if "$ref" in schema:
        return "table"
    bounds = " ".join(f"{sign} {schema[key]}" for key, sign in _BOUNDS.items() if key in schema)
    if schema.get("type") == "array":
        return f"list of {permitted(schema.get('items', {})) or 'values'}"
    kind = {
        "boolean": "`true`, `false`",
        "object": "table",
        "string": "text",
        "integer": "whole number",
        "number": "" if bounds else "number",
    }
    return " ".join(part for part in (kind.get(schema.get("type", ""), ""), bounds) if part)


def models_in(model: type[RigTable]) -> Iterator[type[RigTable]]:
    """Yield a model and the models of the tables inside it."""
    yield model
    for field in model.model_fields.values():
        for part in _types_in(field.annotation):
            yield from models_in(part)


def _types_in(annotation: Any) -> Iterable[type[RigTable]]:
    if isinstance(annotation, type) and issubclass(annotation, RigTable):
        return [annotation]
    return [found for part in getattr(annotation, "__args__", ()) for found in _types_in(part)]


def table(model: type[RigTable], known: Iterable[str] = ()) -> list[str]:
    """Return the lines of a model's table, without the settings that stand elsewhere; none if none are left.

    Raises:
        LookupError: the docstrings do not state what a setting means.
    """
    texts, without = meanings(model), set(known)
    groups: dict[tuple[str, str], dict[str, str]] = {}  # defaults by name, of settings with one meaning
    for name, schema in model.model_json_schema()["properties"].items():
        if name in without:
            continue
        if name not in texts:
            raise LookupError(f"setting tables: the docstring of {model.__name__} does not state what {name} means")
        default = "required" if model.model_fields[name].is_required() else _default(schema.get("default"))
        groups.setdefault((permitted(schema), texts[name].replace("|", "\\|")), {})[f"`{name}`"] = default
    rows = [
        f"| {', '.join(names)} | {', '.join(dict.fromkeys(names.values()))} | {values} | {meaning} |"
        for (values, meaning), names in groups.items()
    ]
    return ["", "| setting | default | permitted | meaning |", "|---|---|---|---|", *rows] if rows else []


def _default(value: Any) -> str:
    return "" if value is None or isinstance(value, dict) else _literal(value)


def _literal(value: Any) -> str:
    return f"`{json.dumps(value, ensure_ascii=False)}`"


def all_tables() -> str:
    """Return the common tables, then those of each driver without the common settings."""
    lines: list[str] = []
    common = {name for model in COMMON.values() for name in model.model_fields}
    for title, model in COMMON.items():
        bases = {name for base in model.__mro__[1:] for name in getattr(base, "model_fields", {})}
        lines += ["", f"## {title}", *table(model, bases)]
    for driver in sorted(installed()):
        own = settings_of(driver)
        lines += ["", f"## `{driver}`", *table(own, common)]
        inside: dict[tuple[str, ...], list[str]] = {}  # names of the models with the same table
        for part in dict.fromkeys(models_in(own)):
            inside.setdefault(tuple(table(part, common)), []).append(f"`{part.__name__}`")
        for rows, names in inside.items():
            lines += (
                ["", f"A table of {' or '.join(names)}:", *rows] if rows and names[0] != f"`{own.__name__}`" else []
            )
    return "\n".join(lines[1:])
