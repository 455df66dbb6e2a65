"""Rig files, settings and parameters files from anywhere: an error in words or a sound rig, nothing else."""

from __future__ import annotations

import codecs
import contextlib
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from daq.replay.calibration import Calibration
from rig_configs import IdentifiedParameters, ParametersFileError, RigFileError, load_rig
from rig_configs.errors import RigConfigError
from rig_configs.load import with_truth

RIG_TEXT = (Path(__file__).parents[2] / "rig_configs" / "virtual.toml").read_text(encoding="utf-8")
KNOWN = IdentifiedParameters(
    {"k1_N_per_m": 2571.25, "zeta1": 0.0213, "SP_kg_m": 2.5e-3},
    np.diag([0.25, 1e-10, 1e-12]),
    {"tests": [{"test": "ring-down-x", "log": "a.mcap", "values": {"k1_N_per_m": 2571.0}}]},
)
ODD = [
    "true",
    "nan",
    "-inf",
    "1e999",
    '"5"',
    "[]",
    "{}",
    "-1",
    "0",
    "9" * 5000,
    "0x" + "f" * 5000,
    "1979-05-27",
    "'''",
    "[" * 5000,
    "{a=" * 3000,
    "[[1.0]]",
    "",
    "\x00",
    "5_0",
    "-0.0",
    "5e-324",
]


@pytest.fixture(scope="module")
def parameters_text(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("known") / "parameters.toml"
    KNOWN.save(path)
    return path.read_text(encoding="utf-8")


def mutated(draw: Callable[..., str], text: str) -> bytes:
    """One to four of: a value exchanged, a line left out, doubled or moved, a byte changed, a piece cut."""
    lines = text.split("\n")
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, len(lines) - 1))
        what = draw(st.sampled_from(["value", "value", "drop", "double", "swap", "key", "cut"]))
        line = lines[at]
        if what == "value" and "=" in line:
            lines[at] = f"{line.partition('=')[0]}= {draw(st.sampled_from(ODD))}"
        elif what == "drop":
            lines[at] = ""
        elif what == "double":
            lines.insert(at, line)
        elif what == "swap":
            other = draw(st.integers(0, len(lines) - 1))
            lines[at], lines[other] = lines[other], lines[at]
        elif what == "key":
            lines[at] = draw(st.text(max_size=12)) + line[draw(st.integers(0, 20)) :]
        else:
            lines[at] = line[: draw(st.integers(0, 40))]
    data = bytearray("\n".join(lines).encode("utf-8", "surrogatepass"))
    if draw(st.booleans()):
        data[draw(st.integers(0, len(data) - 1))] = draw(st.integers(0, 255))
    return bytes(data)


@settings(max_examples=120, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_mutated_rig_file_is_a_rig_or_an_error_in_words(tmp_path: Path, data: st.DataObject) -> None:
    path = tmp_path / "rig.toml"
    path.write_bytes(mutated(data.draw, RIG_TEXT))
    try:
        rig = load_rig(path)
    except RigConfigError:  # anything else fails the test
        return
    assert np.isfinite(rig.physics.total_mass_kg)


@settings(max_examples=120, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_mutated_parameters_are_parameters_or_an_error_in_words(
    tmp_path: Path, data: st.DataObject, parameters_text: str
) -> None:
    path = tmp_path / "parameters.toml"
    path.write_bytes(mutated(data.draw, parameters_text))
    try:
        found = IdentifiedParameters.load(path)
    except ParametersFileError:
        return
    assert np.all(np.isfinite(list(found.values.values())))
    assert np.all(np.isfinite(found.correlation))
    with contextlib.suppress(RigFileError):
        load_rig("virtual", found)


@settings(max_examples=150, deadline=None)
@given(
    key=st.sampled_from(
        ["suspension.k1_N_per_m", "devices.encoder.rate_Hz", "name", "points", "points.A", "", ".", "a.b"]
    ),
    value=st.one_of(st.sampled_from(ODD), st.text(max_size=20), st.from_regex(r"\A[*+-]?[\d.eE+x-]{0,6}%?\Z")),
)
def test_a_setting_is_laid_over_or_refused_in_words(key: str, value: str) -> None:
    with contextlib.suppress(RigFileError):
        load_rig("virtual", settings=[f"{key}={value}"])


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("suspension.k1_N_per_m=true", "number"),
        ("suspension.k1_N_per_m='2600'", "number"),
        ("suspension.k1_N_per_m=nan", "finite"),
        ("rotor.mass_kg=nan", "finite"),
        ("devices.encoder.rate_Hz=true", "integer"),
        ("pendulums.pivot_shift_compensated=1", "boolean"),
        ("suspension.k1_N_per_m=*1.2.3", r"expected a change such as \*1.05 or \+5%"),
        ("suspension.k1_N_per_m=*e", "expected a change"),
        ("suspension.k1_N_per_m=+5.5.5%", "expected a change"),
        ("suspension.k1_N_per_m=*1e300", "less than or equal to"),
        ("suspension.k1_N_per_m=*1e306", "expected a finite number"),
        ("suspension.k1_N_per_m=" + "9" * 5000, "number"),
        ("suspension.k1_N_per_m=" + "[" * 5000, "number"),
        ("pendulums.pivot_shift_compensated=*2", "expected a number at"),
    ],
)
def test_a_value_that_is_not_a_number_is_refused(setting: str, words: str) -> None:
    with pytest.raises(RigFileError, match=words) as caught:
        load_rig("virtual", settings=[setting])
    assert len(str(caught.value)) < 1000


def test_relative_settings_keep_whole_numbers_whole_and_texts_texts() -> None:
    rig = load_rig("virtual", settings=["devices.encoder.rate_Hz=*0.5", "name=*star", "limits.speed_rpm=- 5 %"])
    assert (rig.devices["encoder"].rate_Hz, rig.name) == (500, "*star")
    assert rig.limits.speed_rpm == pytest.approx(0.95 * load_rig("virtual").limits.speed_rpm)


@pytest.mark.parametrize(("mark", "encoding"), [(codecs.BOM_UTF8, "utf-8"), (b"", "utf-16")])
def test_a_byte_order_mark_is_no_fault(tmp_path: Path, mark: bytes, encoding: str, parameters_text: str) -> None:
    rig, parameters, calibration = (tmp_path / name for name in ("rig.toml", "parameters.toml", "calibration.toml"))
    rig.write_bytes(mark + RIG_TEXT.encode(encoding))
    parameters.write_bytes(mark + parameters_text.encode(encoding))
    calibration.write_bytes(mark + "[devices.laser_x]\nrange_m = 0.0251\n".encode(encoding))
    assert load_rig(rig, parameters).suspension.k1_N_per_m == 2571.25
    assert Calibration.load(calibration).devices == {"laser_x": {"range_m": 0.0251}}


@pytest.mark.parametrize(
    "text", ["a = " + "[" * 5000, "a = " + "7" * 5000, "a = 0x" + "f" * 5000, "a." * 5000 + "b = 1"]
)
@pytest.mark.parametrize("load", [load_rig, IdentifiedParameters.load, Calibration.load])
def test_files_made_to_break_readers_are_refused(tmp_path: Path, text: str, load: Callable[[Path], object]) -> None:
    path = tmp_path / "a.toml"
    path.write_text(text)
    with pytest.raises(RigConfigError, match=r"a\.toml: .*expected|a\.toml: not a TOML"):
        load(path)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("value = 2571.25", "value = nan", "k1_N_per_m: expected a finite number"),
        ("value = 2571.25", "value = true", "expected a number, got 'True'"),
        ("value = 2571.25", "value = '5'", "expected a number"),
        ("0.25", "-0.25", "no negative variance"),
        ("0.25", "inf", "finite"),
    ],
)
def test_a_parameters_file_of_other_than_numbers_is_refused(
    tmp_path: Path, parameters_text: str, old: str, new: str, words: str
) -> None:
    path = tmp_path / "parameters.toml"
    assert old in parameters_text
    path.write_text(parameters_text.replace(old, new))
    with pytest.raises(ParametersFileError, match=f"parameters.toml.*{words}"):
        IdentifiedParameters.load(path)


def test_a_correlation_above_one_is_refused() -> None:
    with pytest.raises(ParametersFileError, match="positive semidefinite"):
        IdentifiedParameters({"zeta1": 0.01, "zeta2": 0.01}, np.array([[1e-8, 2e-8], [2e-8, 1e-8]]))


def test_the_truth_changes_by_what_holds_now() -> None:
    rig = load_rig("virtual")
    softer = with_truth(with_truth(rig, "suspension.k1_N_per_m", "*0.5"), "virtual.truth.suspension.k1_N_per_m", "-50%")
    assert softer.true_physics.k1_N_per_m == pytest.approx(0.25 * rig.true_physics.k1_N_per_m)
    assert softer.physics == rig.physics
    with pytest.raises(RigFileError, match="unknown key"):
        with_truth(rig, "suspension.k1", 5.0)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
@pytest.mark.parametrize("target", ["pipe.toml", "/dev/zero", "."])
def test_what_is_no_file_is_refused_without_waiting_for_it(tmp_path: Path, target: str) -> None:
    os.mkfifo(tmp_path / "pipe.toml")
    (tmp_path / "named.toml").symlink_to(tmp_path / target)
    for read in (load_rig, IdentifiedParameters.load):
        with pytest.raises((RigFileError, ParametersFileError), match="not a file"):
            read(tmp_path / "named.toml")


@pytest.mark.parametrize("text", ["1e-400", "-0.3e-999", "*１.05", "+５%"])
def test_a_number_that_is_not_what_it_looks_like_is_refused(text: str) -> None:
    with pytest.raises(RigFileError, match=r"imbalance\.mass_kg"):
        load_rig("virtual", settings=[f"imbalance.mass_kg={text}"])
    assert load_rig("virtual", settings=["imbalance.mass_kg=0.00e-400"]).physics.imbalance_mass_kg == 0
