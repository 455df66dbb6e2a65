"""Rig of the logs that a command takes: their own rig file, or a given one that agrees with it.

Numbers fall into three groups. Facts of the rig (masses, lengths, geometry of the pendulums, gravity, friction) are
the same in all logs that are used together. So is the calibration by which a sensor's samples were decoded: a command
takes the samples of a log, and a rig file with another calibration does not change them. Estimates (k, ζ, c, drag and
the radius of the imbalance) are identified, and a log contains the estimate at the time of its recording. They are
compared only where a command relies on them, drag never. Uncertainties, limits, points, ports and rates are not
compared: those of the rig in use hold.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from daq.log import open_log
from daq.log.snapshot import rig_of
from rig_configs import (
    PARAMETER_UNITS,
    IdentifiedParameters,
    Rig,
    RigFileError,
    load_rig,
    overridden,
    parse_setting,
    with_parameters,
)
from rig_configs.device import displacement_tables
from rig_configs.load import replaced_by, rig_from_text

RigText = tuple[str, str]
"""Origin of a rig file, and its text."""

_FACTS = {"rotor", "imbalance", "pendulums", "suspension"}
_DRAGS = frozenset(f"pendulums.{part}.drag_Nms2_per_rad2" for part in "ab")
_ABSENT = "no such sensor"


@dataclass(frozen=True)
class RigDifference:
    """A number in which the rig of a log differs from the rig in use.

    Attributes:
        log: path of the log.
        key: key of the rig file, or field and channel of a sensor.
        in_log, in_use: both values.
        of_sensor: whether it belongs to the calibration by which the log's samples were decoded.
    """

    log: Path
    key: str
    in_log: object
    in_use: object
    of_sensor: bool


@dataclass(frozen=True)
class RigUse:
    """What a command takes from the rig of its logs.

    Attributes:
        command: the command, for messages.
        facts: whether it takes the facts of the rig, besides the calibration of the sensors.
        estimates: identified numbers that it takes from the rig, names as in parameters.toml.
    """

    command: str
    facts: bool = True
    estimates: frozenset[str] = frozenset()

    @classmethod
    def relying_on_estimates(cls, command: str, known: IdentifiedParameters) -> RigUse:
        """Return the use by a command that takes from the rig all numbers that were not identified."""
        return cls(command, estimates=frozenset(PARAMETER_UNITS) - set(known.values))


def rig_of_logs(
    logs: Sequence[str | Path],
    use: RigUse,
    given: str | Path | RigText | None = None,
    parameters: IdentifiedParameters | None = None,
    settings: Sequence[str] = (),
) -> Rig:
    """Return the rig of the logs that a command takes together.

    Args:
        logs: paths of the logs.
        use: what the command takes from the rig.
        given: a rig file, its name, or its origin and text, instead of the logs' own; None: that of the log that was
            recorded last.
        parameters: identified values in place of the rig's own.
        settings: "key=value" texts over both. A fact that is set is not compared.
    Raises:
        RigFileError: the rig differs from that of a log in what the command takes; all such numbers are listed with
            both values. Or the given file cannot be read.
        LogError: a log does not contain its rig.
    """
    rigs: dict[Path, Rig] = {}
    started: dict[Path, int] = {}
    for log in map(Path, logs):
        with open_log(log) as opened:
            rigs[log], started[log] = rig_of(opened), opened.start_ns
    newest = max(rigs, key=lambda log: started[log])
    if given is None:
        with open_log(newest) as opened:
            chosen, name = rig_of(opened, settings), newest.name
    elif isinstance(given, tuple):
        chosen, name = rig_from_text(*given, None, settings), given[0]
    else:
        chosen, name = load_rig(given, settings=settings), str(given)
    name += " with its settings" if settings else ""
    compared = chosen
    if parameters is not None:
        chosen = with_parameters(chosen, parameters.without(overridden(parameters, settings)))
    _refuse(_differences(rigs, compared, use, {parse_setting(text)[0] for text in settings}), use.command, name)
    return chosen


def _differences(rigs: Mapping[Path, Rig], chosen: Rig, use: RigUse, stated: Collection[str]) -> list[RigDifference]:
    left_out = replaced_by(set(PARAMETER_UNITS) - use.estimates) | _DRAGS | set(stated)
    facts, sensors = _facts(chosen), _sensors(chosen)
    found: list[RigDifference] = []
    for log, rig in rigs.items():
        if use.facts:
            found += [
                RigDifference(log, key, value, facts[key], of_sensor=False)
                for key, value in _facts(rig).items()
                if value != facts[key] and not any(key == each or key.startswith(f"{each}.") for each in left_out)
            ]
        for topic, fields in _sensors(rig).items():
            if topic not in sensors:
                found.append(RigDifference(log, topic, "a sensor", _ABSENT, of_sensor=True))
                continue
            mine = sensors[topic]
            found += [
                RigDifference(log, f"{field} of {topic}", value, mine[field], of_sensor=True)
                for field, value in fields.items()
                if field in mine and mine[field] != value
            ]
    return found


def _facts(rig: Rig) -> dict[str, object]:
    """Return the physical numbers of a rig by their keys, without uncertainties."""
    return dict(_numbers(rig.model_dump(include=_FACTS)))


def _numbers(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, object]]:
    for name, value in table.items():
        if isinstance(value, Mapping):
            yield from _numbers(cast("Mapping[str, Any]", value), f"{prefix}{name}.")
        elif "_std_" not in name:
            yield f"{prefix}{name}", value


def _sensors(rig: Rig) -> dict[str, dict[str, object]]:
    """Return the numbers by which the samples of each channel are decoded and placed, by topic."""
    roles, found = rig.roles, dict[str, dict[str, object]]()
    for sensor in (*roles.displacements, *roles.witnesses):
        found[sensor.topic] = {
            "axis": sensor.axis,
            "range_m": sensor.range_m,
            "lever_ratio": sensor.lever_ratio,
            "direction_deg": sensor.off_axis_deg,
        }
    for table in (each for device in rig.devices.values() for each in displacement_tables(device)):
        if table.topic in found:
            found[table.topic]["gain_factor"] = table.gain_factor
    if roles.angles is not None:
        found[roles.angles.topic] = {"counts_per_revolution": roles.angles.counts_per_revolution}
    if roles.phase is not None:
        found[roles.phase.topic] = {"index_angle_deg": roles.phase.index_angle_deg}
    return found


def _refuse(found: Sequence[RigDifference], command: str, name: str) -> None:
    """Raise `RigFileError` with all differences and what to do, if there are any."""
    if not found:
        return
    values: dict[tuple[str, str, str], list[str]] = {}
    for each in found:
        values.setdefault((each.key, str(each.in_log), str(each.in_use)), []).append(each.log.name)
    lines = [
        f"  {key}: {in_use} in {name}, {in_log} in {', '.join(logs)}" for (key, in_log, in_use), logs in values.items()
    ]
    advice = list[str]()
    if facts := [each for each in found if not each.of_sensor]:
        advice.append(
            "Take the logs of one rig at a time. If a number was corrected later, state it for all logs as a setting, "
            f"for example {facts[0].key}={facts[0].in_use}"
        )
    if any(each.of_sensor for each in found):
        advice.append(
            "The samples of a log are as they were decoded, with its own calibration; `rig replay` decodes them again "
            "with a corrected one"
        )
    raise RigFileError(
        f"{command}: expected one rig, but the rig in {name} differs from that of logs in numbers that "
        "this command takes:\n" + "\n".join([*lines, *advice])
    )
