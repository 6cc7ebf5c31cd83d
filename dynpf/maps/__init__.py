"""Maps: what a measurement is compared with."""

from dynpf.maps.landmarks import LandmarkMap

__all__ = ["LandmarkMap"]
