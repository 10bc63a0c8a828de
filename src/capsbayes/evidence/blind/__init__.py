"""Blind sessions: measured capsules drawn from simulated shapes, with a true effect that a plain model lacks.

The shapes come from the simulator itself, at parameters between those of the
databases that models are made of and on another mesh. What a microscope adds is
drawn on their outlines as geometry. This package reads no model and no operator of
an effect of the library, so that what is found again was not put in by the same
code; the exam, which diagnoses the sessions, does. Only an effect of a user's own
is put in by its operator.
"""

from capsbayes.evidence.blind.effects import TRUE_EFFECTS, TrueEffect, true_effect_named
from capsbayes.evidence.blind.lab import Lab, Noise
from capsbayes.evidence.blind.operated import true_effect_of
from capsbayes.evidence.blind.session import BlindSession, draw_session, simulate_session

__all__ = [
    "TRUE_EFFECTS",
    "BlindSession",
    "Lab",
    "Noise",
    "TrueEffect",
    "draw_session",
    "simulate_session",
    "true_effect_named",
    "true_effect_of",
]
