"""Public names of `uncertainty`; each is imported at its first use."""

from .budget import (
    Budget as Budget,
    Contribution as Contribution,
    GroupContribution as GroupContribution,
)
from .budgets import Budgets as Budgets
from .coverage import (
    coverage_factor as coverage_factor,
    ellipsoid_factor as ellipsoid_factor,
    numerical_tolerance as numerical_tolerance,
)
from .errors import (
    BadInput as BadInput,
    BadModel as BadModel,
    TooManyTrials as TooManyTrials,
    UncertaintyError as UncertaintyError,
)
from .group import (
    Group as Group,
    Input as Input,
)
from .linear_check import (
    LinearCheck as LinearCheck,
    check_linear as check_linear,
)
from .monte_carlo import (
    TrialLimits as TrialLimits,
    monte_carlo as monte_carlo,
)
from .sensitivities import (
    linear_budgets as linear_budgets,
    second_order_variance as second_order_variance,
)
from .source import (
    ErrorSource as ErrorSource,
    reliability_degrees as reliability_degrees,
)
from .spread import (
    MonteCarlo as MonteCarlo,
    Spread as Spread,
)
