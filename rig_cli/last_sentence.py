"""The sentence at the end of a command: what came out, for a person."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from daq.acquisition.device_check import passed
from daq.drivers.checks import Checks, DeviceCheck
from rig_basics.texts import number_of
from rig_configs import PARAMETER_SYMBOLS, IdentifiedParameters


def check_sentence(devices: Mapping[str, Checks], rotor_warning: str = "") -> str:
    """Return whether all devices are fine, or the worst failure and what to do."""
    failed = {name: checks for name, checks in devices.items() if not passed(checks)}
    if failed:
        others = f"{len(failed)} of {number_of(len(devices), 'device')} " + ("fail" if len(failed) > 1 else "fails")
        name, what, found = _worst(failed)
        return _ended(f"{others}: {name}: {what}{_compared(found)}{f'; {found.note}' if found.note else ''}")
    fine = {1: "The device is fine", 2: "Both devices are fine"}.get(
        len(devices), f"All {number_of(len(devices), 'device is', 'devices are')} fine"
    )
    if rotor_warning:
        return _ended(f"{fine}, but {rotor_warning}")
    unresolved = sum(check.passed is None for checks in devices.values() for check in checks.values())
    if unresolved:
        verb = "is" if unresolved == 1 else "are"
        return f"{fine}; {number_of(unresolved, 'check')} {verb} not resolved, with the reason above."
    return f"{fine}."


def _ended(text: str) -> str:
    return text if text.endswith((".", "?", "!")) else f"{text}."


def _worst(failed: Mapping[str, Checks]) -> tuple[str, str, DeviceCheck]:
    """Return the first failure of a device that showed nothing, otherwise the first failure."""
    found = [(name, what, c) for name, checks in failed.items() for what, c in checks.items() if c.failed]
    return next((one for one in found if one[2].value is None), found[0])


def _compared(found: DeviceCheck) -> str:
    value = "" if found.value is None else f" {found.value}"
    return value + ("" if found.expected is None else f", expected {found.expected}")


def identify_sentence(found: IdentifiedParameters, logs: int, to_record: str, file: Path, *, with_points: bool) -> str:
    """Return which parameters were identified, how good they are, and what to do next.

    Args:
        found: parameters.
        logs: number of logs that determine them.
        to_record: advice for the others; empty if none is absent.
        file: file of the parameters.
        with_points: whether points are among the given logs, so that they can be compared.
    """
    share = {name: found.std[name] / abs(value) for name, value in found.values.items()}
    if not share:
        return f"No parameter was identified from {number_of(logs, 'log')}; the warnings above give the reasons."
    worst = max(share, key=lambda name: share[name])
    names = ", ".join(PARAMETER_SYMBOLS[name] for name in PARAMETER_SYMBOLS if name in share)
    good = f"standard uncertainties up to {100 * share[worst]:.2g} % ({PARAMETER_SYMBOLS[worst]})"
    absent = ", ".join(PARAMETER_SYMBOLS[name] for name in PARAMETER_SYMBOLS if name not in share)
    command = "validate RIG FOLDER" if with_points else "test RIG point A"
    following = f"next: rig {command} --parameters {file}"
    if absent:
        following = f"not identified: {absent}; {to_record}"
    return f"{names} identified from {number_of(logs, 'log')}, {good}; {following}."


def predict_sentence(result: Mapping[str, Any]) -> str:
    """Return what will happen at the speed of a prediction.

    Args:
        result: the JSON object of `rig predict` for one speed.
    """
    at = f"At {result['speed_rpm']:.4g} rpm"
    ends = list(dict.fromkeys(str(each["reaches"]) for each in result["releases_within_play"]))
    if len(ends) > 1:
        return f"{at} a release may end in any of: {', '.join(_END.get(end, _KINDS.get(end, end)) for end in ends)}."
    if ends:
        return f"{at} {_release_words(ends[0], result)}."
    stable = [state for state in result["steady_states"] if state["stable"]]
    if not stable:
        return f"{at} no steady state is stable."
    least = min(stable, key=lambda state: float(state["amplitude_mm"]))
    kind = _KINDS.get(str(least["type"]), "the motion")
    return f"{at} {kind} is stable, with an amplitude of {least['amplitude_mm']:.3g} mm."


_KINDS = {"I": "balance", "II": "a state of Type II", "III": "a state of Type III"}
_END = {"I": "balance", "not settled": "no settled motion", "slipping": "permanent slipping"}


def _release_words(end: str, result: Mapping[str, Any]) -> str:
    first = result["releases_within_play"][0]
    if end == "slipping":
        return "released pendulums slip for ever; the rotor is not balanced"
    if end == "held by friction":
        return "dry friction holds released pendulums; the rotor is not balanced"
    if end == "not settled":
        return f"released pendulums do not settle within {number_of(int(first['revolutions']), 'revolution')}"
    reached = [state for state in result["steady_states"] if state["type"] == end and state["stable"]]
    left = min((float(state["amplitude_mm"]) for state in reached), default=0.0)
    amplitude = f"the amplitude that remains is {left:.3g} mm" if left >= 1e-3 else "no vibration remains"
    kind = _KINDS.get(end, "the only motion")
    verb = "balance the rotor" if end == "I" else f"settle in {kind}, which does not balance the rotor,"
    return f"released pendulums {verb} after {first['after_s']:.3g} s; {amplitude}"


def validation_sentence(points: Mapping[str, Mapping[str, Any]], passed: bool) -> str:
    """Return whether the points pass, or those that do not, the first with its reason.

    Args:
        points: as in the JSON object of `rig validate`.
        passed: whether the whole validation passed.
    """
    missed = {name: point for name, point in points.items() if point["verdict"] != "pass"}
    if missed:
        name, point = next(iter(missed.items()))
        share = f"{len(missed)} of {number_of(len(points), 'point')} {'does' if len(missed) == 1 else 'do'} not pass"
        others = f" ({', '.join(missed)})" if len(missed) > 1 else ""
        return _ended(f"{share}{others}: {name}: {point['verdict']}, {point['why']}")
    if not points:
        return "No point was compared: record one by rig test."
    fine = f"{', '.join(points)} {'passes' if len(points) == 1 else 'pass'}"
    return f"{fine}." if passed else f"{fine}, but the whole validation does not; the reason is above."


def parameters_sentence(facts: Mapping[str, Any]) -> str:
    """Return how many parameters a file contains, from how many logs, and which is known least.

    Args:
        facts: a file in the JSON object of `rig parameters show`.
    """
    known = facts["parameters"]
    if not known:
        return "The file contains no parameter."
    name, least = max(known.items(), key=lambda item: float(item[1]["relative_std"]))
    origin = f" from {number_of(len(facts['tests']), 'log')}" if facts["tests"] else ""
    uncertain = f"{100 * least['relative_std']:.2g} % ({PARAMETER_SYMBOLS.get(name, name)})"
    return f"{number_of(len(known), 'parameter')}{origin}, standard uncertainties up to {uncertain}."


def plot_sentence(kind: str, files: Sequence[str], left: int) -> str:
    """Return how many figures were drawn, where the last one is, and how many logs are not in any.

    Args:
        kind: kind of the figures.
        files: paths of the figures, at least one.
        left: number of logs that were not drawn.
    """
    place = files[0] if len(files) == 1 else f"{files[0]} to {files[-1]}"
    others = f"; {number_of(left, 'log is', 'logs are')} not drawn, with the reason above" if left else ""
    return f"{number_of(len(files), 'figure')} of kind {kind} drawn: {place}{others}."


def written_sentence(done: str, samples: Mapping[str, int], missing: int, files: Sequence[Path]) -> str:
    """Return what an export or import wrote, and whether all of it.

    Args:
        done: what was done, such as "exported".
        samples: number of samples of each channel.
        missing: number of parts of the recording that are missing from it.
        files: files that were written.
    """
    whole = f"; {number_of(missing, 'part is', 'parts are')} missing, with the reason above" if missing else ""
    amount = f"{number_of(sum(samples.values()), 'sample')} of {number_of(len(samples), 'channel')}"
    place = f"{files[0]}" if len(files) == 1 else f"{number_of(len(files), 'file')}, the first {files[0]}"
    return f"{amount} {done} to {place}{whole}."


def campaign_sentence(found: Mapping[str, Any]) -> str:
    """Return how many tests of a rig are done, and which one is next.

    Args:
        found: the JSON object of `rig test` without a test.
    """
    possible = [row for row in found["tests"] if row["state"] != "refused"]
    to_do = [row["test"] for row in possible if row["state"] != "done"]
    amount = f"{len(possible) - len(to_do)} of {number_of(len(possible), 'test')} done in {found['folder']}"
    if not to_do:
        return f"{amount}; next: rig identify {found['folder']}." if possible else "The rig can do no test."
    return f"{amount}; next: rig test RIG {to_do[0]}."
