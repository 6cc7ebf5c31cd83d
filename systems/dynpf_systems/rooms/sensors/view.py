"""The field of view of sensors."""

import math
from typing import Annotated

from msgspec import Meta

__all__ = ["FieldOfView"]

FieldOfView = Annotated[float, Meta(gt=0.0, le=math.tau)]
"""An angle in rad, centred on the robot's heading."""
