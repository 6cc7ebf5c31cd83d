"""Maps: what a measurement is compared with."""

from dynpf.maps.landmarks import LandmarkMap
from dynpf.maps.occupancy import FREE, OCCUPIED, UNKNOWN, OccupancyGrid

__all__ = ["FREE", "OCCUPIED", "UNKNOWN", "LandmarkMap", "OccupancyGrid"]
