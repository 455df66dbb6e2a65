"""Public names of `analysis.maps`; each is imported at its first use."""

from .answers import (
    MapAnswer as MapAnswer,
    answer as answer,
)
from .axes import (
    MapAxis as MapAxis,
)
from .families import (
    BestValue as BestValue,
    BorderFamily as BorderFamily,
    SearchRange as SearchRange,
)
from .files import (
    load_map as load_map,
    write_map as write_map,
)
from .question import (
    MapQuestion as MapQuestion,
    parameters_source as parameters_source,
    rig_source as rig_source,
)
from .records import (
    MapRecord as MapRecord,
    record as record,
)
from .refinement import (
    refined_grid as refined_grid,
)
