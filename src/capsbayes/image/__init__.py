"""From a picture of a capsule to its measurement; OpenCV is used here only."""

from capsbayes.image.frames import Picture
from capsbayes.image.measure import Sighting, measure, sight

__all__ = ["Picture", "Sighting", "measure", "sight"]
