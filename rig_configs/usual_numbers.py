"""Unusual numbers of a rig file that the schema allows: probable unit errors, in words.

They cause a warning only, because an unusual rig is possible.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from rig_configs.device import DisplacementTable, RotorNodeSettings
from rig_configs.ports import PRINTED, is_placeholder
from rig_configs.schema import Rig

Slips = tuple[tuple[float, str], ...]
"""Other units of a number: factor from the other unit to the file's unit, and the unit's name."""

_MASS: Slips = ((1e-3, "grams"), (1e3, "tonnes"))
_LENGTH: Slips = ((1e-3, "millimetres"), (1e-2, "centimetres"))
_SHARE: Slips = ((1e-2, "per cent"),)
_FREQUENCY: Slips = ((1e3, "kHz"),)
_TORQUE: Slips = ((1e-3, "mN m s"), (1e-2, "N cm s"))


@dataclass(frozen=True)
class Usual:
    """Usual range of a number.

    Attributes:
        least, most: limits in its unit, generous on both sides.
        unit: unit for the message.
        slips: other units that may have been used by mistake.
        zero: meaning of 0; None if 0 is not special.
    """

    least: float
    most: float
    unit: str
    slips: Slips = ()
    zero: str | None = None

    def doubt(self, key: str, value: float) -> str | None:
        """Describe why a value is unusual; None if it is usual.

        Args:
            key: key in the rig file.
            value: value in its unit.
        """
        if self.least <= value <= self.most or (value == 0 and self.zero is not None):
            return None
        unit = f" {self.unit}" if self.unit else ""
        meant = [name for factor, name in self.slips if self.least <= value * factor <= self.most]
        slip = f": {' or '.join(meant)}?" if meant else "."
        none = f", or 0 for {self.zero}" if self.zero else ""
        return f"{key} is {value:g}{unit}{slip} Usual is {self.least:g} to {self.most:g}{unit}{none}"


_RIG = {
    "rotor.mass_kg": Usual(0.05, 2000, "kg", _MASS),
    "imbalance.mass_kg": Usual(1e-5, 3, "kg", _MASS, "no weight"),
    "imbalance.radius_m": Usual(1e-4, 0.5, "m", _LENGTH, "no weight"),
    "suspension.k1_N_per_m": Usual(20, 1e8, "N/m", ((1e3, "N/mm"),)),
    "suspension.k2_N_per_m": Usual(20, 1e8, "N/m", ((1e3, "N/mm"),)),
    "suspension.zeta1": Usual(0, 0.5, "", _SHARE),
    "suspension.zeta2": Usual(0, 0.5, "", _SHARE),
    "suspension.gravity_m_per_s2": Usual(9.7, 9.9, "m/s²", ((9.81, "g"),), "an upright shaft"),
    "pendulums.pivot_shift_m": Usual(1e-6, 0.02, "m", _LENGTH, "none"),
    "limits.speed_rpm": Usual(30, 3000, "rpm", ((60, "Hz"), (9.55, "rad/s"))),
    "limits.amplitude_m": Usual(1e-4, 0.05, "m", _LENGTH),
}
_PENDULUM = {
    "mass_kg": Usual(1e-3, 5, "kg", _MASS, "no pendulum"),
    "length_m": Usual(3e-3, 0.3, "m", _LENGTH),
    "damping_Nms_per_rad": Usual(1e-7, 0.1, "N m s/rad", _TORQUE, "none"),
    "friction_arm_m": Usual(1e-7, 0.02, "m", _LENGTH, "none"),
    "ball_radius_m": Usual(5e-4, 0.1, "m", _LENGTH, "a pendulum"),
    "rolling_resistance_m": Usual(1e-8, 1e-3, "m", _LENGTH, "none"),
}
_DEVICE = {  # numbers of sensors and nodes of any driver
    "rate_Hz": Usual(20, 2e5, "Hz", _FREQUENCY),
    "range_m": Usual(2e-4, 1, "m", _LENGTH),
    "lever_ratio": Usual(0.1, 10, "", _SHARE),
    "gain_std": Usual(1e-6, 0.05, "", _SHARE, "none"),
    "clock_tolerance_ppm": Usual(0.01, 1000, "ppm"),
}


def doubts(rig: Rig) -> list[str]:
    """List probable errors of a rig file, one text each: the number, the probable unit, the usual range.

    Args:
        rig: loaded rig; the truth of a simulated one is not checked.
    """
    return [*_numbers(rig), *_ports(rig)]


def _numbers(rig: Rig) -> Iterator[str]:
    for key, usual in _RIG.items():
        table, name = key.split(".")
        yield from _odd(key, getattr(getattr(rig, table), name), usual)
    for pendulum, table in (("a", rig.pendulums.a), ("b", rig.pendulums.b)):
        for name, usual in _PENDULUM.items():
            yield from _odd(f"pendulums.{pendulum}.{name}", getattr(table, name), usual)
    for device, settings in rig.devices.items():
        tables = {f"devices.{device}": settings} | {f"devices.{device}.{key}": value for key, value in settings}
        for key, table in tables.items():
            if isinstance(table, DisplacementTable | RotorNodeSettings):
                for name, usual in _DEVICE.items():
                    yield from _odd(f"{key}.{name}", getattr(table, name, None), usual)


def _odd(key: str, value: object, usual: Usual) -> Iterator[str]:
    if isinstance(value, int | float) and (doubt := usual.doubt(key, value)):
        yield doubt


def _ports(rig: Rig) -> Iterator[str]:
    for name, device in rig.devices.items():
        if is_placeholder(device.port) and not (rig.virtual and device.port == PRINTED):
            yield f"devices.{name}.port is {device.port!r}: a placeholder? Give the port that it is plugged into"
