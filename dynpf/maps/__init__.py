"""Maps: what a measurement is compared with."""

from dynpf.maps.bitmap import decode_bitmap, from_grey
from dynpf.maps.distance import distance_field
from dynpf.maps.landmarks import LandmarkMap
from dynpf.maps.occupancy import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from dynpf.maps.segments import SegmentMap
from dynpf.maps.timeline import MapTimeline

__all__ = [
    "FREE",
    "OCCUPIED",
    "UNKNOWN",
    "LandmarkMap",
    "MapTimeline",
    "OccupancyGrid",
    "SegmentMap",
    "decode_bitmap",
    "distance_field",
    "from_grey",
]
