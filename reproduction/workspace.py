"""Environment in which an item is reproduced: its folder, rigs by settings, its progress."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from dynamics.equations.parameters import RotorParameters
from rig_configs import load_rig

VIRTUAL, ISOTROPIC = "virtual", "isotropic"


@dataclass(frozen=True)
class Workspace:
    """An item's environment.

    Attributes:
        folder: of its recordings and files.
        progress: called with the completed share, 0 … 1.
    """

    folder: Path
    progress: Callable[[float], None] = field(default=lambda share: None)

    def physics(self, rig: str = VIRTUAL, settings: Sequence[str] = ()) -> RotorParameters:
        """Return a shipped rig's physical parameters with settings applied.

        Args:
            rig: name of a shipped rig file.
            settings: "key=value" as for `--set`.
        """
        return load_rig(rig, settings=list(settings)).physics

    def recordings(self, name: str) -> Path:
        """Create and return a new folder for logs."""
        found = self.folder / "recordings" / name
        found.mkdir(parents=True, exist_ok=True)
        return found


def numbers_of(p: RotorParameters) -> dict[str, float | str]:
    """Return a rig's parameters for an item's list, by the names of the rig file and with derived ones."""
    return {
        "rotor.mass_kg": p.rotor_mass_kg,
        "pendulums.a.mass_kg": p.a.mass_kg,
        "pendulums.b.mass_kg": p.b.mass_kg,
        "pendulums.length_m": p.a.length_m,
        "c3_Nms_per_rad": p.a.damping_Nms_per_rad,
        "c4_Nms_per_rad": p.b.damping_Nms_per_rad,
        "S_P_kg_m": p.imbalance_moment_kg_m,
        "k1_N_per_m": p.k1_N_per_m,
        "k2_N_per_m": p.k2_N_per_m,
        "zeta1": p.zeta1,
        "zeta2": p.zeta2,
    }
