"""Public names of `analysis`; each is imported at its first use."""

from .budget import (
    PredictedBudgets as PredictedBudgets,
    predicted_budgets as predicted_budgets,
)
from .errors import (
    AnalysisError as AnalysisError,
    BadFigureName as BadFigureName,
    NoStableState as NoStableState,
    NotEnoughData as NotEnoughData,
)
from .figures.balancing_plane import draw_balancing as draw_balancing
from .figures.basins import draw_basins as draw_basins
from .figures.bode import draw_bode as draw_bode
from .figures.branches import draw_branches as draw_branches
from .figures.coexistence import draw_coexistence as draw_coexistence
from .figures.dial import draw_dial as draw_dial
from .figures.fit import (
    FitCurve as FitCurve,
    fit_curves as fit_curves,
)
from .figures.health import draw_health as draw_health
from .figures.multipliers import draw_multipliers as draw_multipliers
from .figures.orbit import draw_orbit as draw_orbit
from .figures.orders import draw_orders as draw_orders
from .figures.page import write_figure as write_figure
from .figures.parameter_history import draw_parameter_history as draw_parameter_history
from .figures.plane_maps import draw_map as draw_map
from .figures.point_loss import draw_point_loss as draw_point_loss
from .figures.polar import draw_polar as draw_polar
from .figures.reaction import draw_reaction as draw_reaction
from .figures.residuals import draw_residuals as draw_residuals
from .figures.slip import draw_slip as draw_slip
from .figures.spectrum import draw_spectrum as draw_spectrum
from .figures.stability_map import (
    MapPoint as MapPoint,
    draw_points_on_map as draw_points_on_map,
)
from .figures.start_ups import draw_start_ups as draw_start_ups
from .figures.state_maps import draw_states as draw_states
from .figures.steady_states import draw_steady_states as draw_steady_states
from .figures.time_history import draw_time as draw_time
from .figures.tracked import draw_tracked as draw_tracked
from .figures.waterfall import draw_waterfall as draw_waterfall
from .moment_margins import (
    MomentMargins as MomentMargins,
    moment_margins as moment_margins,
)
from .prediction import (
    Prediction as Prediction,
    predict_point as predict_point,
)
from .quantities.amplification import (
    Amplification as Amplification,
    amplification_factors as amplification_factors,
    principal_axis as principal_axis,
)
from .quantities.orbits import (
    OrbitEllipse as OrbitEllipse,
    forward_backward as forward_backward,
    orbit_ellipse as orbit_ellipse,
)
from .quantities.order_maps import (
    OrderMap as OrderMap,
    order_map as order_map,
    resampled_order_track as resampled_order_track,
)
from .quantities.order_tracking import (
    OrderTrack as OrderTrack,
    order_track as order_track,
)
from .quantities.rotor_phase import (
    phase_at as phase_at,
    speed_at as speed_at,
)
from .quantities.slip import (
    SlipTrack as SlipTrack,
    slip_track as slip_track,
)
from .quantities.slow_roll import (
    slow_roll_vector as slow_roll_vector,
    without_slow_roll as without_slow_roll,
)
from .quantities.spectra import (
    Spectrum as Spectrum,
    amplitude_spectrum as amplitude_spectrum,
    full_spectrum as full_spectrum,
    power_density as power_density,
)
from .release_probabilities import (
    EndProbabilities as EndProbabilities,
    ReleaseDraws as ReleaseDraws,
    end_probabilities as end_probabilities,
)
from .report.campaign import Campaign as Campaign
from .report.write import write_report as write_report
from .results import PointResult as PointResult
from .rig_model import RigModel as RigModel
from .settled_scatter import settled_scatter as settled_scatter
from .simulated_run import (
    SimulatedRun as SimulatedRun,
    simulate_run as simulate_run,
)
from .steady_state import (
    SteadyMeasurement as SteadyMeasurement,
    measure as measure,
)
from .validation import (
    Validation as Validation,
    validate as validate,
    validate_point as validate_point,
)
