"""Reading a rig file, laying settings over it, and saying clearly what is wrong with it."""

from __future__ import annotations

import difflib
import math
import re
import tomllib
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from dynamics.errors import OutsideDomain
from dynamics.parameters import imbalance_radius
from rig_configs.errors import RigFileError
from rig_configs.parameters_file import IdentifiedParameters
from rig_configs.schema import Rig


def shipped_rigs() -> list[str]:
    """Names of the rig files that come with the package."""
    return sorted(p.name[:-5] for p in resources.files("rig_configs").iterdir() if p.name.endswith(".toml"))


def load_rig(
    path_or_name: str | Path,
    parameters: str | Path | IdentifiedParameters | None = None,
    settings: Mapping[str, Any] | Sequence[str] = (),
) -> Rig:
    """Read a rig file.

    Args:
        path_or_name: a TOML file, or the name of a shipped rig ("virtual", "isotropic").
        parameters: a parameters.toml whose values replace the file's (k1 … SP).
        settings: dotted keys to values, as a mapping or as "key=value" texts, laid over everything else. A value
            "*1.05" or "+5%" changes the number that is there.
    Raises:
        RigFileError: lists every fault with file, key, what was expected, what came, and the nearest known name.
    """
    source, text = _read(path_or_name)
    try:
        raw = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise RigFileError(f"{source}: not a TOML file: {error}") from error
    if parameters is not None:
        known = parameters if isinstance(parameters, IdentifiedParameters) else IdentifiedParameters.load(parameters)
        _lay_parameters(raw, known, source)
    pairs = settings.items() if isinstance(settings, Mapping) else [parse_setting(s) for s in settings]
    for key, value in pairs:
        apply_setting(raw, key, value, source)
    return validate(raw, source)


def validate(raw: dict[str, Any], source: str) -> Rig:
    """A rig from a raw table; see load_rig for the errors."""
    try:
        return Rig.model_validate(raw)
    except ValidationError as error:
        lines = [f"{source}: {_sentence(e)}" for e in error.errors()]
        raise RigFileError("\n".join(lines)) from error


def parse_setting(text: str) -> tuple[str, Any]:
    """Split "key=value"; the value is TOML where it parses as such, otherwise text.

    Raises:
        RigFileError: no "=" in the text.
    """
    key, sign, value = text.partition("=")
    if not sign or not key.strip():
        raise RigFileError(f"setting {text!r}: expected key=value, for example suspension.zeta2=0.05")
    try:
        return key.strip(), tomllib.loads(f"v = {value}")["v"] if not _is_relative(value) else value.strip()
    except tomllib.TOMLDecodeError:
        return key.strip(), value.strip()


def apply_setting(raw: dict[str, Any], key: str, value: Any, source: str = "--set") -> None:
    """Put one value into a raw table by its dotted key; "*1.05" and "+5%" are relative to what is there.

    Raises:
        RigFileError: the key runs through something that is no table, or a relative value has nothing to change.
    """
    table = raw
    *path, last = key.split(".")
    for part in path:
        table = table.setdefault(part, {})
        if not isinstance(table, dict):
            raise RigFileError(f"{source}: {key}: {part} is a value, not a table")
    if isinstance(value, str) and _is_relative(value):
        value = _relative(table.get(last), value, key, source)
    table[last] = value


def _is_relative(text: str) -> bool:
    return bool(re.fullmatch(r"\s*(\*\s*[\d.eE+-]+|[+-]\s*[\d.]+\s*%)\s*", text))


def _relative(current: Any, text: str, key: str, source: str) -> float:
    if not isinstance(current, int | float):
        raise RigFileError(f"{source}: {key}={text}: there is no number at {key} to change")
    text = text.replace(" ", "")
    return current * float(text[1:]) if text[0] == "*" else current * (1 + float(text[:-1]) / 100)


def _read(path_or_name: str | Path) -> tuple[str, str]:
    path = Path(path_or_name)
    if not path.suffix and str(path_or_name) in shipped_rigs():
        name = f"{path_or_name}.toml"
        return name, (resources.files("rig_configs") / name).read_text(encoding="utf-8")
    try:
        return str(path), path.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        near = difflib.get_close_matches(str(path_or_name), shipped_rigs(), n=1)
        hint = f"; did you mean the shipped rig {near[0]!r}?" if near else ""
        raise RigFileError(
            f"{path}: no such rig file. Give a TOML file or one of the shipped rigs {shipped_rigs()}{hint}"
        ) from error
    except (OSError, UnicodeDecodeError) as error:
        raise RigFileError(f"{path}: cannot be read as a text file: {error}") from error


def _lay_imbalance(raw: dict[str, Any], moment_kg_m: float, source: str) -> None:
    """An identified S_P as the radius of the file's imbalance mass; a mass the schema will refuse is left to it."""
    table = raw.get("imbalance")
    mass = table.get("mass_kg") if isinstance(table, dict) else None
    if isinstance(mass, bool) or not isinstance(mass, int | float) or not 0 <= mass < math.inf:
        return
    try:
        apply_setting(raw, "imbalance.radius_m", imbalance_radius(moment_kg_m, mass), source)
    except OutsideDomain as error:
        raise RigFileError(f"{source} with these parameters: {error}") from error


def _lay_parameters(raw: dict[str, Any], known: IdentifiedParameters, source: str) -> None:
    places = {
        "k1_N_per_m": "suspension.k1_N_per_m",
        "k2_N_per_m": "suspension.k2_N_per_m",
        "zeta1": "suspension.zeta1",
        "zeta2": "suspension.zeta2",
        "c3_Nms_per_rad": "pendulums.a.damping_Nms_per_rad",
        "c4_Nms_per_rad": "pendulums.b.damping_Nms_per_rad",
    }
    for name, value in known.values.items():
        if name in places:
            apply_setting(raw, places[name], value, source)
        elif name == "SP_kg_m":
            _lay_imbalance(raw, value, source)


def _sentence(error: ErrorDetails) -> str:
    """One fault in words: key, what was expected, what came, the nearest known name."""
    key = ".".join(str(part) for part in error["loc"])
    if error["type"] == "extra_forbidden":
        near = _nearest(error["loc"])
        hint = f"; did you mean {near}?" if near else ""
        known = ", ".join(_names_at(error["loc"][:-1]))
        return f"{key}: unknown key{hint} (units are part of a name). Known here: {known}"
    if error["type"] == "missing":
        return f"{key}: missing; expected {_expectation(error['loc'])}"
    got = error.get("input")
    shown = repr(got) if not isinstance(got, dict) else "a table"
    return f"{key}: {error['msg']}, got {shown}"


def _model_at(path: Sequence[str | int]) -> type[BaseModel] | None:
    model: type[BaseModel] | None = Rig
    for part in path:
        field = model.model_fields.get(str(part)) if model else None
        if field is None:  # a key of a dict of tables, such as points.A
            continue
        candidates = [field.annotation, *get_args(field.annotation)]
        model = next((c for c in candidates if isinstance(c, type) and issubclass(c, BaseModel)), None)
    return model


def _names_at(path: Sequence[str | int]) -> list[str]:
    model = _model_at(path)
    return list(model.model_fields) if model else []


def _nearest(path: Sequence[str | int]) -> str | None:
    names = _names_at(path[:-1])
    wrong = str(path[-1])
    with_unit = [n for n in names if n.startswith(f"{wrong}_")]
    near = with_unit or difflib.get_close_matches(wrong, names, n=1, cutoff=0.5)
    return ".".join([*map(str, path[:-1]), near[0]]) if near else None


def _expectation(path: Sequence[str | int]) -> str:
    model = _model_at(path[:-1])
    field = model.model_fields.get(str(path[-1])) if model else None
    if field is None:
        return "a value"
    inner = next((c for c in (field.annotation,) if isinstance(c, type) and issubclass(c, BaseModel)), None)
    if inner is not None:
        return f"a table with {', '.join(inner.model_fields)}"
    return f"a {getattr(field.annotation, '__name__', str(field.annotation))}"
