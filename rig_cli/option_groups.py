"""Groups of options in the help of commands, in the order in which they are shown."""

from __future__ import annotations

from itertools import count

from cyclopts import Group

_place = count()


def _next(title: str) -> Group:
    return Group(title, sort_key=next(_place))


TEST_NUMBERS: Group = _next("Numbers of the test")
POSITIONS: Group = _next("Positions of a sensor's target")
CLOSINGS: Group = _next("Encoders at their locks")
PLANE: Group = _next("Plane of the map")
RELEASES: Group = _next("Releases")
SPEED: Group = _next("Speed")
MOTION_END: Group = _next("End of the motion")
QUESTIONS: Group = _next("Other questions")
MODEL: Group = _next("Model")
WORK: Group = _next("Work")
CONDITIONS: Group = _next("Conditions on the logs")
COLUMNS: Group = _next("Columns of the file")
RECORDING: Group = _next("What the file does not contain")
LOG_PART: Group = _next("Part of the recording")
AXIS_ANGLE: Group = _next("Angle between sensor and stiffness axes")
SIMULATION: Group = _next("Simulation")
DISPLAYS: Group = _next("Displays")
RIG_NUMBERS: Group = _next("Numbers of the rig")
OUTPUT: Group = _next("Output")
