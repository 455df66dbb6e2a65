"""`rig react`: motion after a sudden change of the rig at speed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from cyclopts import Parameter

from rig_basics.units import TO_RPM
from rig_cli.console import print_json, wait_for_compilation
from rig_cli.numbers import Positive, PositiveSeconds
from rig_cli.option_groups import MOTION_END, OUTPUT
from rig_cli.options import Force, Json, ParametersPath, RigFile, Settings, check_outputs, warn_of_filled, what_if_words
from rig_cli.speed import NO_SPEED, SpeedChoice
from rig_configs import IdentifiedParameters, RigFileError, load_rig

if TYPE_CHECKING:
    from dynamics.steady.reaction import Reaction


@Parameter(name="*", group=MOTION_END)
@dataclass(frozen=True)
class ReactionEnd:
    """End of the motion after the change.

    Attributes:
        share: deviation at which the reaction is over, as a share of the largest one.
        seconds: duration of the motion; None: until the slowest decay is over.
    """

    share: Annotated[Positive, Parameter(help="of the largest deviation, at which the reaction is over")] = 0.05
    seconds: Annotated[PositiveSeconds | None, Parameter(help="followed; default: until the slowest has decayed")] = (
        None
    )


_UNTIL_SHARE = ReactionEnd()


def react(
    rig: RigFile,
    *,
    change: Annotated[
        list[str] | None, Parameter(help="KEY=VALUE that changes at once: imbalance.radius_m=+20%")
    ] = None,
    speed: SpeedChoice = NO_SPEED,
    until: ReactionEnd = _UNTIL_SHARE,
    plot: Annotated[
        Path | None, Parameter(group=OUTPUT, help="write a figure: .svg, .png, .pdf, or .html, which zooms")
    ] = None,
    parameters: ParametersPath = None,
    settings: Settings = None,
    force: Force = False,
    json: Json = False,
) -> int:
    """Simulate how the pendulums answer a sudden change at speed.

    The results are the vibration, its peak, and the time until the rotor is balanced again. The motion starts in
    the stable state of the rig before the change and continues with --change at the same speed.

    Example: `rig react my.toml --point E --change imbalance.radius_m=+20%`
    """
    check_outputs("rig react: --plot", plot, force=force)
    if not change:
        raise RigFileError("rig react: expected --change KEY=VALUE, as imbalance.radius_m=+20%")
    known = IdentifiedParameters.load(parameters) if parameters else IdentifiedParameters({}, np.zeros((0, 0)))
    before = load_rig(rig, known, settings or [])
    warn_of_filled(known, before, settings)
    after = load_rig(rig, known, [*(settings or []), *change])
    speed_rad_s, share = speed.rad_s("rig react", before), until.share
    with wait_for_compilation("dynamics"):
        from dynamics.steady.reaction import reaction  # loads numba

        found = reaction(
            known.with_effects(before.physics), known.with_effects(after.physics), speed_rad_s, share, until.seconds
        )
    title = f"{before.name}, {', '.join(change)} at {speed_rad_s * TO_RPM:.1f} rpm{what_if_words(settings, '; ')}"
    if plot is not None:
        from analysis.figures.page import write_figure
        from analysis.figures.reaction import draw_reaction

        write_figure(plot, draw_reaction(found, title, share), title)
    result = _json(found, speed_rad_s, share) | {
        "change": list(change),
        "what_if": list(settings or []),
        "plot": None if plot is None else str(plot),
    }
    if json:
        print_json(result)
        return 0
    _print(result)
    return 0


def _json(found: Reaction, speed: float, share: float) -> dict[str, Any]:
    after = found.after
    return {
        "speed_rpm": speed * TO_RPM,
        "before": found.before.type,
        "before_mm": 1e3 * found.before.amplitude_m,
        "reaches": None if after is None else after.type,
        "after_mm": 1e3 * (after.amplitude_m if after is not None else float(found.amplitude_m[-1])),
        "peak_mm": 1e3 * found.peak_m,
        "share": share,
        "reaction_s": found.reaction_s,
        "time_constant_s": found.time_constant_s,
        "followed_s": float(found.time_s[-1]),
    }


def _print(result: dict[str, Any]) -> None:
    print(
        f"at {result['speed_rpm']:.1f} rpm from {result['before']}, {result['before_mm']:.4f} mm rms; peak "
        f"{result['peak_mm']:.4f} mm"
    )
    if result["reaches"] is None:
        print(f"no stable state is reached within {result['followed_s']:.1f} s; {result['after_mm']:.4f} mm are left")
        return
    print(
        f"reaches {result['reaches']}, {result['after_mm']:.4f} mm: within {100 * result['share']:g} % of the largest "
        f"deviation after {result['reaction_s']:.2f} s; slowest time constant {result['time_constant_s']:.2f} s"
    )
