"""Front end: from pixels to cones in the car frame."""

from conegraph.frontend.base import Candidates, Detections, Detector, FrontEnd
from conegraph.frontend.factory import make_front_end

__all__ = ["Candidates", "Detections", "Detector", "FrontEnd", "make_front_end"]
