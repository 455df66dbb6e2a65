"""Public names of `dynamics`; each is imported at its first use."""

from .equations.balancing import (
    GravityDisk as GravityDisk,
    balanced_angles as balanced_angles,
    balancing_region as balancing_region,
    gravity_disk as gravity_disk,
)
from .equations.model import (
    ChosenModel as ChosenModel,
    choose_model as choose_model,
)
from .equations.parameters import (
    Pendulum as Pendulum,
    RotorParameters as RotorParameters,
)
from .equations.scene import Scene as Scene
from .equations.speed_history import SpeedHistory as SpeedHistory
from .errors import (
    DynamicsError as DynamicsError,
    NoBalancedState as NoBalancedState,
    NotConverged as NotConverged,
    OutsideDomain as OutsideDomain,
)
from .motions.batch import (
    BatchMotion as BatchMotion,
    simulate_batch as simulate_batch,
)
from .motions.integrate import (
    Motion as Motion,
    locked_orbit as locked_orbit,
    locked_state as locked_state,
    simulate as simulate,
)
from .motions.sensitivities import sensitivities as sensitivities
from .motions.start_ups import (
    random_starts as random_starts,
    start_ups_from_rest as start_ups_from_rest,
)
from .stability.borders import Borders as Borders
from .stability.stability_map import (
    StabilityMap as StabilityMap,
    stability_map as stability_map,
    stability_map_over as stability_map_over,
)
from .steady.basins.basin_map import (
    BasinMap as BasinMap,
    basins as basins,
)
from .steady.basins.ends import End as End
from .steady.branches import (
    Branch as Branch,
    SteadyBranches as SteadyBranches,
    steady_branches as steady_branches,
)
from .steady.outcome import (
    ReleaseOutcome as ReleaseOutcome,
    release_outcome as release_outcome,
)
from .steady.point_loss import point_losses as point_losses
from .steady.reaction import (
    Reaction as Reaction,
    reaction as reaction,
)
from .steady.steady_motions import (
    multipliers as multipliers,
    steady_states as steady_states,
)
from .steady.steady_state import (
    SteadyState as SteadyState,
    SteadyStates as SteadyStates,
)
