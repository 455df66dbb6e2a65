"""Public names of `identification`; each is imported at its first use."""

from .compare import (
    ParameterComparison as ParameterComparison,
    compare_parameters as compare_parameters,
)
from .curve import FittedCurve as FittedCurve
from .difference import ParameterDifference as ParameterDifference
from .errors import (
    FitFailed as FitFailed,
    IdentificationError as IdentificationError,
    NotIdentifiable as NotIdentifiable,
)
from .estimate import Estimate as Estimate
from .history import (
    History as History,
    parameter_history as parameter_history,
)
from .identify import (
    Identification as Identification,
    NamedFit as NamedFit,
    identify as identify,
)
from .joint import (
    ConsistencyRow as ConsistencyRow,
    combine as combine,
)
from .joint.budget import (
    ParameterBudgets as ParameterBudgets,
    parameter_budgets as parameter_budgets,
)
from .pendulums.release import fit_release as fit_release
from .pendulums.spin_down import (
    SpinDownFit as SpinDownFit,
    fit_spin_down as fit_spin_down,
)
from .pendulums.spin_down_run import fit_spin_down_run as fit_spin_down_run
from .pendulums.suspension_knowledge import Knowledge as Knowledge
from .pendulums.transient import TransientFit as TransientFit
from .plan.experiment import Experiment as Experiment
from .plan.planning import (
    ExperimentPlan as ExperimentPlan,
    PlanAnswer as PlanAnswer,
    plan_experiments as plan_experiments,
)
from .plan.requirements import (
    Requirement as Requirement,
    parse_requirement as parse_requirement,
)
from .plan.sensors import SensorProperties as SensorProperties
from .release_check import check_releases as check_releases
from .ring_down.equivalent import (
    EquivalentLinear as EquivalentLinear,
    equivalent_linear as equivalent_linear,
)
from .ring_down.fit import (
    RingDownFit as RingDownFit,
    fit_ring_down as fit_ring_down,
    fit_ring_down_runs as fit_ring_down_runs,
)
from .run_up.fit import (
    RunUpFit as RunUpFit,
    fit_run_up as fit_run_up,
    fit_run_up_run as fit_run_up_run,
)
from .rungs import Rung as Rung
from .tracking.replay import (
    SmoothedRun as SmoothedRun,
    TrackedRun as TrackedRun,
    track as track,
)
from .tracking.tracker import (
    SensorNoise as SensorNoise,
    Tracked as Tracked,
    Tracker as Tracker,
)
