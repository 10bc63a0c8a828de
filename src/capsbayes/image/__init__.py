"""From a picture of a capsule to its measurement; OpenCV is used here only."""

from capsbayes.image.frames import Picture
from capsbayes.image.measure import measure, sight
from capsbayes.image.sighting import Sighting

__all__ = ["Picture", "Sighting", "measure", "sight"]
