"""What a distance word means is the model's: found by the sensor's name, forced by the rig file, kept in the log."""

from __future__ import annotations

import numpy as np
import pytest

from daq.drivers.optoncdt import distance_words, sensor_answers, wire as optoncdt
from daq.drivers.optoncdt.far_end import PlayedLaser, SimulatedLaser
from daq.drivers.optoncdt.settings import Laser
from daq.drivers.optoncdt.stream import LaserPipeline
from daq.errors import DeviceError, LogError
from daq.items import RX, Batch
from daq.virtual_rig.beam import Beam
from tests.daq.hand_made_laser import HandMadeLaser

START_NS = 1_700_000_000_000_000_000
RANGE_M = 0.025
ERRORS = [*distance_words.ERROR_CODES]
RIG_TABLE = {"driver": "optoncdt", "port": "p", "axis": "x"}


def laser(identity: dict[str, object] | None = None, **settings: object) -> LaserPipeline:
    config = Laser.model_validate({**RIG_TABLE, **settings})
    return LaserPipeline("laser_x", config, identity or {})


def blocks(codes: np.ndarray, first: int = 70_000) -> bytes:
    k = first + np.arange(len(codes))
    ticks = 25 * k
    words = np.column_stack([codes, k % optoncdt.COUNTER_WRAP, ticks & 0xFFFF, ticks >> 16 & 0xFFFF])
    return optoncdt.encode_block(words.astype(np.uint32))


def displacement(pipeline: LaserPipeline, codes: list[int] | np.ndarray) -> np.ndarray:
    """Of these words, split so that both the compiled pass and the full decoder see some."""
    wire = blocks(np.asarray(codes))
    parts = [wire[:100], wire[100:]]
    items = [item for part in parts for item in pipeline.feed(RX, part, START_NS)]
    return np.concatenate([item.columns["displacement_m"] for item in items if isinstance(item, Batch)])


def test_the_1900_has_the_scaling_of_its_own() -> None:
    codes = np.tile([98_232, 98_232 + 32_768, 98_232 + 65_536, 0, 230_604], 10)
    found = displacement(laser({"scaling": "ILD1900"}), codes)
    expected = ((codes - 98_232) / 65_536 - 0.5) * RANGE_M
    assert found == pytest.approx(expected, abs=1e-15)


def test_a_mastered_sensor_measures_from_its_zero_with_words_of_18_bits() -> None:
    """(102/65520 · x − 51) · range/100: 0 at the word 32760, and twice the range above it is still a distance."""
    found = displacement(laser({"scaling": distance_words.MASTERED}), [32_760, 97_000, 262_072, 262_076])
    expected = [(102 / 65_520 * x - 51) * RANGE_M / 100 for x in (32_760, 97_000, 262_072)]
    assert found[:3] == pytest.approx(expected, abs=1e-12)
    assert abs(found[0]) < 1e-12
    assert np.isnan(found[3])


def test_a_mastered_sensor_keeps_its_zero() -> None:
    sensor = HandMadeLaser()
    sensor.set_up(scaling="ILD1420 mastered")
    assert "OUTPUT RS422" in sensor.heard
    assert not any("MASTERMV" in command for command in sensor.heard)


def test_words_above_the_valid_ones_are_no_readings_for_either_scaling() -> None:
    for scaling, most in (("ILD1420", 65_520), ("ILD1900", 230_604)):
        codes = np.array([100, most, most + 1, 250_000, *ERRORS] * 3)
        pipeline = laser({"scaling": scaling})
        found = displacement(pipeline, codes)
        assert np.array_equal(np.isnan(found), codes > most)
        assert pipeline.losses["invalid"] == np.count_nonzero(codes > most)


def test_a_log_without_a_scaling_is_decoded_with_the_default() -> None:
    codes = np.random.default_rng(3).integers(0, 65_600, 500)
    expected = np.where(codes <= 65_520, (102.0 / 65_520 * codes - 1.0) * RANGE_M / 100.0, np.nan) - 0.5 * RANGE_M
    for identity in ({}, {"name": "ILD1900-25"}, {"scaling": "ILD1420"}):
        assert displacement(laser(identity), codes).tobytes() == expected.tobytes()


def test_without_an_identity_the_rig_file_decides() -> None:
    assert displacement(laser(scaling="ILD1900"), [131_000] * 20) == pytest.approx(0.0, abs=1e-12)
    laser_with_identity = laser({"scaling": "ILD1420"}, scaling="ILD1900")  # the log has priority
    assert np.isnan(displacement(laser_with_identity, [131_000] * 20)).all()


@pytest.mark.parametrize("scaling", ["ILD1402", "", 1420, None, ["ILD1420"], {}])
def test_an_invalid_scaling_is_refused_with_a_message(scaling: object) -> None:
    with pytest.raises(DeviceError, match=r"laser_x: expected .*ILD1420, .*ILD1900.*got"):
        laser({"scaling": scaling})
    with pytest.raises(LogError, match=r"ILD1420, .*ILD1900"):
        PlayedLaser(Laser.model_validate(RIG_TABLE), {"scaling": scaling})


@pytest.mark.parametrize("name", sorted(distance_words.SCALINGS))
def test_words_and_metres_are_inverse(name: str) -> None:
    scaling = distance_words.SCALINGS[name]
    codes = np.arange(scaling.most + 1, dtype=np.uint32)
    for range_m in (0.002, 0.025, 0.5):
        assert np.array_equal(
            distance_words.code(distance_words.metres(codes, range_m, scaling), range_m, scaling), codes
        )


def test_a_lone_jump_is_marked_above_the_1420s_words_too() -> None:
    codes = 131_000 + np.random.default_rng(1).integers(-3, 4, 600)
    codes[300] ^= 1 << 13
    pipeline = laser({"scaling": "ILD1900"})
    displacement(pipeline, codes)
    assert pipeline.losses["suspect"] == 1


# --- set-up ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "scaling"),
    [
        ("ILD1220-10", "ILD1420"),
        ("ILD1320-100", "ILD1420"),
        ("ILD1420", "ILD1420"),
        ("ild 1420-500 CL1", "ILD1420"),
        ("ILD1750-25", "ILD1900"),
        ("optoNCDT 1900", "ILD1900"),
        ("ILD1900-2", "ILD1900"),
    ],
)
def test_the_scaling_is_derived_from_the_name(name: str, scaling: str) -> None:
    assert HandMadeLaser(name).set_up()["scaling"] == scaling


@pytest.mark.parametrize("name", ["", "ILD1402-50", "ILD14201", "ILD9999-1420", "IFD2410", "confocalDT"])
def test_a_model_whose_scaling_is_not_known_is_refused_unless_the_rig_file_forces_one(name: str) -> None:
    sensor = HandMadeLaser(name)
    with pytest.raises(
        DeviceError, match=r"1220, 1320, 1420, 2300 as ILD1420; 1750, 1900 as ILD1900.*devices\.laser_x\.scaling"
    ):
        sensor.set_up()
    assert "OUTPUT RS422" not in sensor.heard
    identity = HandMadeLaser(name).set_up(scaling="ILD1900")
    assert (identity["name"], identity["scaling"]) == (name, "ILD1900")


def test_the_rig_files_scaling_goes_before_the_names() -> None:
    assert HandMadeLaser("ILD1420-25").set_up(scaling="ILD1900")["scaling"] == "ILD1900"


@pytest.mark.parametrize("command", ["MASTERMV NONE", "OUTREDUCEDEVICE NONE"])
def test_what_changes_words_or_leaves_samples_out_is_switched_off_before_the_stream(command: str) -> None:
    sensor = HandMadeLaser()
    sensor.set_up()
    assert sensor.heard.index(command) < sensor.heard.index("OUTPUT RS422")


@pytest.mark.parametrize("command", ["MASTERMV", "OUTREDUCEDEVICE"])
@pytest.mark.parametrize("refusal", ["E200 Unknown command", "E210 unknown command MASTERMV", "E1 ?"])
def test_a_model_that_does_not_know_such_a_command_is_set_up_all_the_same(command: str, refusal: str) -> None:
    sensor = HandMadeLaser(answers={command: refusal})
    assert sensor.set_up()["serial"] == "12345678"
    assert "OUTPUT RS422" in sensor.heard


@pytest.mark.parametrize("command", ["MASTERMV", "OUTREDUCEDEVICE"])
@pytest.mark.parametrize("refusal", ["E202 Access denied", "E104 Timeout", "E230 Unknown parameter"])
def test_a_refusal_that_leaves_it_as_it_was_is_an_error(command: str, refusal: str) -> None:
    with pytest.raises(DeviceError, match=f"'{command} NONE' refused: {refusal}"):
        HandMadeLaser(answers={command: refusal}).set_up()


# --- simulated and played ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("scaling", [None, "ILD1900"])
def test_a_simulated_sensor_is_of_the_model_whose_scaling_the_rig_file_forces(scaling: str | None) -> None:
    config = Laser.model_validate({**RIG_TABLE, "scaling": scaling})
    far_end = SimulatedLaser(config, Beam.unmoved(), serial="1")
    info = sensor_answers.parse_info(far_end.receive(b"GETINFO\n").decode().splitlines())
    assert info["name"] == (scaling or "ILD1420")
    seen = np.array([-0.005, 0.0, 0.005])
    codes = far_end._words(seen, np.arange(3), np.arange(3) * 1e-3)[:, 0]
    model = distance_words.SCALINGS[info["name"]]
    assert distance_words.metres(codes, RANGE_M, model) - RANGE_M / 2 == pytest.approx(seen, abs=1e-6)


def test_a_played_sensor_without_a_name_bears_that_of_its_scaling() -> None:
    for identity, name in (({}, "ILD1420"), ({"scaling": "ILD1900"}, "ILD1900"), ({"name": "ILD1750"}, "ILD1750")):
        played = PlayedLaser(Laser.model_validate(RIG_TABLE), identity)
        assert f"Name: {name}\r\n".encode() in played.hear(b"GETINFO\n")
