"""From a picture, a film, an .rtdc file or a contour to the measurement of a capsule; OpenCV is used here only."""

from capsbayes.image.by_hand import ByHand
from capsbayes.image.detect import Detection
from capsbayes.image.files import Picture
from capsbayes.image.measure import detect, measure
from capsbayes.image.target import edge_offset_of

__all__ = ["ByHand", "Detection", "Picture", "detect", "edge_offset_of", "measure"]
