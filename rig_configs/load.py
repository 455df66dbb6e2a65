"""Reading of a rig file, application of settings, and messages about its errors."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any, cast, get_args, get_origin

import numpy as np
from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from dynamics.equations.parameters import imbalance_radius
from dynamics.errors import OutsideDomain
from rig_configs.drag import Drag
from rig_configs.drivers import settings_of
from rig_configs.errors import RigConfigError, RigFileError
from rig_configs.parameters_file import IdentifiedParameters
from rig_configs.physical_numbers import PARAMETERS
from rig_configs.ports import refuse_shared_ports, refuse_unseen_locks
from rig_configs.schema import NO_DRIVER, Rig
from rig_configs.toml_text import parse_toml, read_text

_OTHER_ENCODING = "cp1252"
"""Encoding of files that devices name and that are not UTF-8: the code page in which programs for Windows write."""


def shipped_rigs() -> list[str]:
    """Return the names of the rig files that come with the package."""
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
        settings: dotted keys to values, as a mapping or as "key=value" texts, applied last. A value "*1.05" or "+5%"
            changes the current number.
    Raises:
        RigFileError: lists every error with file, key, expected and actual value, and the nearest known name.

    Example:
        >>> from rig_configs import load_rig
        >>> rig = load_rig("virtual", settings={"rotor.mass_kg": "+5%", "suspension.zeta1": 0.03})
        >>> round(rig.physics.rotor_mass_kg, 3), rig.physics.zeta1
        (7.35, 0.03)
    """
    return rig_from_text(*rig_text(path_or_name), parameters, settings)


def rig_from_text(
    source: str,
    text: str,
    parameters: str | Path | IdentifiedParameters | None = None,
    settings: Mapping[str, Any] | Sequence[str] = (),
) -> Rig:
    """Return a rig from the text of a rig file; see load_rig.

    Args:
        source: origin of the text, for messages.
        text: TOML.
        parameters, settings: as for load_rig.
    """
    raw = parse_toml(text, source)
    if parameters is not None:
        known = parameters if isinstance(parameters, IdentifiedParameters) else IdentifiedParameters.load(parameters)
        _apply_parameters(raw, known, source)
    pairs = settings.items() if isinstance(settings, Mapping) else [parse_setting(s) for s in settings]
    for key, value in pairs:
        apply_setting(raw, key, value, source)
    _read_files(raw, source)
    rig = validate(raw, source)
    refuse_shared_ports(rig.devices, source)  # not in the schema, because the rig of a log opens no port
    refuse_unseen_locks(rig.roles, source)
    return rig


def _read_files(raw: dict[str, Any], source: str) -> None:
    """Put the texts of files that devices name (`DeviceSettings.files`) into the devices' tables."""
    for name, device in (_as_table(raw.get("devices")) or {}).items():
        table = _as_table(device) or {}
        for key, text_key in _files_of(table).items():
            path, place = table.get(key), f"{source}: devices.{name}.{key}"
            if isinstance(path, str) and path:
                if text_key in table:
                    raise RigFileError(f"{place}: expected either a file or its text ({text_key}), got both")
                try:
                    table[text_key] = read_text(Path(source).parent / path, other=_OTHER_ENCODING)
                except OSError as error:
                    raise RigFileError(f"{place}: {path!r:.200} cannot be read as a text file: {error}") from error


def _files_of(table: Mapping[str, Any]) -> Mapping[str, str]:
    """Return `DeviceSettings.files` of a device's driver; errors of the driver's name are left to the schema."""
    try:
        return settings_of(str(table.get("driver"))).files
    except ValueError:  # usual: the schema names the driver
        return {}


def with_parameters(rig: Rig, known: IdentifiedParameters) -> Rig:
    """Return a rig with identified values in place of its own, independent of the settings it was loaded with.

    Example:
        >>> import numpy as np
        >>> from rig_configs import IdentifiedParameters, load_rig, with_parameters
        >>> known = IdentifiedParameters({"zeta1": 0.025}, np.array([[1e-4**2]]))
        >>> with_parameters(load_rig("virtual"), known).physics.zeta1
        0.025
    """
    raw = rig.model_dump(exclude_unset=True)
    _apply_parameters(raw, known, rig.name)
    return validate(raw, rig.name)


def overridden(known: IdentifiedParameters, settings: Sequence[str]) -> set[str]:
    """Return the names of identified values that settings replace, whose identification is then invalid."""
    return set_by(settings) & set(known.values)


def set_by(settings: Sequence[str]) -> set[str]:
    """Return the names as in parameters.toml of the values that settings set."""
    keys = [parse_setting(text)[0] for text in settings]
    return {
        name
        for name, parameter in PARAMETERS.items()
        if any(place == key or place.startswith(f"{key}.") for place in parameter.places for key in keys)
    }


def replaced_by(names: Iterable[str]) -> set[str]:
    """Return the keys of the rig file whose values identified parameters of these names replace."""
    return {PARAMETERS[name].places[-1] for name in names}


def with_truth(rig: Rig, key: str, value: Any) -> Rig:
    """Return a simulated rig with one number of its truth changed; "*1.05" and "+5%" change the current value.

    Args:
        rig: rig with a [virtual] table.
        key: key as in the physical part, with or without "virtual.truth." before it.
        value: a number, or a change.
    Raises:
        RigFileError: an unknown number, or an impossible value.
    """
    key = key.removeprefix("virtual.truth.")
    raw = rig.model_dump(exclude_none=True)
    if "virtual" not in raw:
        raise RigFileError(f"rig {rig.name} has no [virtual] table: it has no truth to change")
    truth: dict[str, Any] = raw["virtual"]["truth"]
    section: dict[str, Any] | None = truth
    physical: Any = raw
    for part in key.split("."):
        physical = (_as_table(physical) or {}).get(part)
    *path, leaf = key.split(".")
    for part in path:
        section = _as_table(section.setdefault(part, {})) if section is not None else None
    if section is not None and leaf not in section and isinstance(physical, int | float):
        section[leaf] = physical  # the change is relative to the rig file's value
    apply_setting(truth, key, value, "truth")
    return validate(raw, "virtual.truth")


def refusal(rig: Rig, name: str, value: float) -> str | None:
    """Explain why a rig cannot have an identified parameter of this value; None if it can.

    Args:
        rig: the rig.
        name: name as in parameters.toml.
        value: value of the parameter, SI.
    """
    raw = rig.model_dump()
    if name == "SP_kg_m" and not raw["imbalance"]["mass_kg"]:
        return None if value >= 0 else f"expected at least 0, got {value:g}"
    try:
        _apply_parameters(raw, IdentifiedParameters({name: value}, np.zeros((1, 1))), rig.name)
        Rig.model_validate(raw)
    except ValidationError as error:
        return error.errors()[0]["msg"].replace("Input should be", "expected")
    except RigConfigError as error:
        return str(error)
    return None


def validate(raw: dict[str, Any], source: str) -> Rig:
    """Return a rig from a raw table; see load_rig for the errors."""
    try:
        return Rig.model_validate(raw)
    except ValidationError as error:
        lines = [f"{source}: {_sentence(e, raw)}" for e in error.errors()]
        raise RigFileError("\n".join(lines)) from error


def parse_setting(text: str) -> tuple[str, Any]:
    """Split "key=value"; the value is parsed as TOML if possible, otherwise it is text.

    Raises:
        RigFileError: no "=" in the text.
    """
    key, sign, value = text.partition("=")
    if not sign or not key.strip():
        raise RigFileError(f"setting {text!r}: expected key=value, for example suspension.zeta2=0.05")
    value = value.strip()
    if _means_relative(value):
        return key.strip(), value
    try:
        found = parse_toml(f"v = {value}", key)
    except RigFileError:  # usual: a text without quotation marks
        return key.strip(), value
    return key.strip(), found["v"] if len(found) == 1 else value


def _as_table(value: object) -> dict[str, Any] | None:
    return cast("dict[str, Any]", value) if isinstance(value, dict) else None


def apply_setting(raw: dict[str, Any], key: str, value: Any, source: str = "setting") -> None:
    """Set one value in a raw table by its dotted key; "*1.05" and "+5%" are relative to the current value.

    Raises:
        RigFileError: a part of the key is not a table, a relative value has no current number, or its number is
            invalid.
    """
    table = raw
    *path, last = key.split(".")
    for part in path:
        inner = _as_table(table.setdefault(part, {}))
        if inner is None:
            raise RigFileError(f"{source}: {key}: {part} is a value, not a table")
        table = inner
    if isinstance(value, str) and _means_relative(value):
        current = table.get(last)
        if isinstance(current, int | float) and not isinstance(current, bool):
            value = _relative(current, value, key, source)
        elif re.fullmatch(_RELATIVE, value.strip()):
            raise RigFileError(f"{source}: {key}={value}: expected a number at {key} to change, found none")
    table[last] = value


_NUMBER = r"(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_RELATIVE = re.compile(
    rf"(?P<times>\*)\s*(?P<factor>[+-]?{_NUMBER})|(?P<sign>[+-])\s*(?P<percent>{_NUMBER})\s*%", re.ASCII
)
_MAX_SHOWN = 60  # letters of a value in a message


def _means_relative(text: str) -> bool:
    """Whether a text is intended as a change, valid or not."""
    text = text.strip()
    return text.startswith("*") or (text[:1] in ("+", "-") and text.endswith("%"))


def _relative(current: float, text: str, key: str, source: str) -> float:
    found = _RELATIVE.fullmatch(text.strip())
    if found is None:
        raise RigFileError(f"{source}: {key}={text[:_MAX_SHOWN]}: expected a change such as *1.05 or +5%")
    factor = float(found["factor"]) if found["times"] else 1 + float(found["sign"] + found["percent"]) / 100
    changed = current * factor
    if not math.isfinite(changed):
        raise RigFileError(f"{source}: {key}={text[:_MAX_SHOWN]}: expected a finite number, got {changed}")
    return int(changed) if isinstance(current, int) and changed == int(changed) else changed


def rig_text(path_or_name: str | Path) -> tuple[str, str]:
    """Return the origin of a rig file and its text.

    Args:
        path_or_name: see load_rig.
    Raises:
        RigFileError: the file does not exist, or cannot be read.
    """
    path = Path(path_or_name)
    if not path.suffix and str(path_or_name) in shipped_rigs():
        name = f"{path_or_name}.toml"
        return name, (resources.files("rig_configs") / name).read_text(encoding="utf-8")
    try:
        return str(path), read_text(path)
    except FileNotFoundError as error:
        near = difflib.get_close_matches(str(path_or_name), shipped_rigs(), n=1)
        hint = f"; did you mean the shipped rig {near[0]!r}?" if near else ""
        raise RigFileError(
            f"{path}: no such rig file. Give a TOML file or one of the shipped rigs {shipped_rigs()}{hint}"
        ) from error
    except OSError as error:
        raise RigFileError(f"{path}: cannot be read as a text file: {error}") from error


def _apply_imbalance(raw: dict[str, Any], moment_kg_m: float, source: str) -> None:
    """Set the radius of the file's imbalance mass from an identified S_P; an invalid mass is left to the schema."""
    table = _as_table(raw.get("imbalance"))
    mass = None if table is None else table.get("mass_kg")
    if isinstance(mass, bool) or not isinstance(mass, int | float) or not 0 <= mass < math.inf:
        return
    try:
        apply_setting(raw, "imbalance.radius_m", imbalance_radius(moment_kg_m, mass), source)
    except OutsideDomain as error:
        raise RigFileError(f"{source} with these parameters: {error}") from error


def _apply_parameters(raw: dict[str, Any], known: IdentifiedParameters, source: str) -> None:
    for name, value in known.values.items():
        if name == "SP_kg_m":
            _apply_imbalance(raw, value, source)
        else:
            apply_setting(raw, PARAMETERS[name].key, value, source)
    if drag := Drag.of(known.provenance):
        for part, value in zip("ab", np.maximum(drag.values, 0.0).tolist(), strict=True):
            apply_setting(raw, f"pendulums.{part}.drag_Nms2_per_rad2", value, source)


def _sentence(error: ErrorDetails, raw: Mapping[str, Any]) -> str:
    """Describe one error: key, expected and actual value, nearest known name."""
    key = ".".join(str(part) for part in error["loc"])
    if error["type"] == "extra_forbidden":
        near = _nearest(error["loc"], raw)
        hint = f"; did you mean {near}?" if near else ""
        known = ", ".join(_names_at(error["loc"][:-1], raw))
        return f"{key}: unknown key{hint} (units are part of a name). Known here: {known}"
    if error["type"] == "missing":
        return f"{key}: missing; expected {_expectation(error['loc'], raw)}"
    got = error.get("input")
    if error["type"] == NO_DRIVER:
        others = [name for name in raw.get("devices", {}) if name != error["loc"][1]]
        if near := difflib.get_close_matches(str(error["loc"][1]), others, n=1, cutoff=0.7):
            return f"{key}: a device without a driver; did you mean devices.{near[0]}?"
    of_whole_table = error["type"] in ("value_error", NO_DRIVER)  # its text contains the value
    if isinstance(got, dict) and of_whole_table:
        return f"{key}{': ' if key else ''}{error['msg'].removeprefix('Value error, ')}"
    return f"{key}: {error['msg']}, got {_shown(got)}"


def _shown(value: Any) -> str:
    """Format a value for a message; long values are shortened."""
    if isinstance(value, dict):
        return "a table"
    text = repr(cast("Sequence[Any]", value)[:_MAX_SHOWN] if isinstance(value, str | list) else value)
    return text if len(text) <= 2 * _MAX_SHOWN else f"{text[: 2 * _MAX_SHOWN]}…"


def _model_at(path: Sequence[str | int], raw: Mapping[str, Any]) -> type[BaseModel] | None:
    model: type[BaseModel] | None = Rig
    if len(path) > 1 and path[0] == "devices":
        table = raw["devices"][path[1]]
        return settings_of(table["driver"])  # the error was found by this class
    for part in path:
        field = model.model_fields.get(str(part)) if model else None
        if field is not None:  # None for a key of a dict of tables, such as points.A
            candidates = [field.annotation, *get_args(field.annotation)]
            model = next((c for c in candidates if isinstance(c, type) and issubclass(c, BaseModel)), None)
    return model


def _names_at(path: Sequence[str | int], raw: Mapping[str, Any]) -> list[str]:
    model = _model_at(path, raw)
    return list(model.model_fields) if model else []


def _nearest(path: Sequence[str | int], raw: Mapping[str, Any]) -> str | None:
    names = _names_at(path[:-1], raw)
    wrong = str(path[-1])
    with_unit = [n for n in names if n.startswith(f"{wrong}_")]
    near = with_unit or difflib.get_close_matches(wrong, names, n=1, cutoff=0.5)
    return ".".join([*map(str, path[:-1]), near[0]]) if near else None


def _expectation(path: Sequence[str | int], raw: Mapping[str, Any]) -> str:
    model = _model_at(path[:-1], raw)
    field = model.model_fields.get(str(path[-1])) if model else None
    if field is None:
        return "a value"
    inner = next((c for c in (field.annotation,) if isinstance(c, type) and issubclass(c, BaseModel)), None)
    if inner is not None:
        return f"a table with {', '.join(inner.model_fields)}"
    if get_origin(field.annotation) is dict:
        of = get_args(field.annotation)[1]
        keys = f", each with {', '.join(of.model_fields)}" if hasattr(of, "model_fields") else ""
        return f"tables [{path[-1]}.NAME]{keys}"
    return f"a {getattr(field.annotation, '__name__', str(field.annotation))}"
