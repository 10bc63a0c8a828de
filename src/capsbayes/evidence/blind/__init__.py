"""Sessions in which an effect is hidden: drawn from simulated shapes, their truth known.

Shapes come from the simulator itself, at parameters between those of the
databases that models are made of and on another mesh. What a microscope adds is
drawn on their outlines as geometry. What draws them reads no model and no effect's
operator, so that what is found again has not been put in by the same code; the
exam, which diagnoses them, does.
"""

from capsbayes.evidence.blind.hideable import HIDEABLE, Hideable, hideable_named
from capsbayes.evidence.blind.lab import Lab, Noise
from capsbayes.evidence.blind.session import HiddenSession, drawn_session

__all__ = ["HIDEABLE", "HiddenSession", "Hideable", "Lab", "Noise", "drawn_session", "hideable_named"]
