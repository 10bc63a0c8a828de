"""The cells of the exam: sessions with the same hidden fault, each in a laboratory of its own."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from capsbayes.effects import catalogue
from capsbayes.evidence.blind.effects import TRUE_EFFECTS, TrueEffect
from capsbayes.evidence.blind.lab import Lab
from capsbayes.evidence.blind.operated import true_effect_of
from capsbayes.evidence.blind.pools import POOLS
from capsbayes.evidence.exam.labs import drawn_lab
from capsbayes.model import Effect

HALVES = {"locked": 1, "development": 0}
"""Halves of the exam in the order of their page, and which of the two ranges of seeds each has."""

_SESSIONS, _NULL_SESSIONS, _UNKNOWN_SESSIONS = 6, 60, 22  # those with a bound of their own, enough to meet it
_DRAWN = {  # a small and a large size of faults that are not simulated; see `_IN_SI`
    "halo": (0.008, 0.02),
    "exposure": (0.02, 0.05),
    "pixel_scale": (0.01, 0.025),
    "swelling": (0.01, 0.02),
    "modulus_slope": (0.7, 2.0),
    "pixel_aspect": (1.02, 1.04),
    "distortion": (-0.01, -0.02),
    "taper": (0.004, 0.01),
}
_FAINT = ("distortion", "taper")  # which move edges by 0.01 l at most, at any size that is probable
_OF_FLOW = {"velocity_scale": 0.08, "flow_rate_error": 0.08}  # faults that only flow rates show
_IN_SI: dict[str, Callable[[float, Lab], float]] = {
    "halo": lambda size, lab: size * lab.half_width,
    "exposure": lambda size, lab: size * lab.half_width / _middle(lab),
    "swelling": lambda size, lab: size / _middle(lab),
}
_CLEAR = {
    "pre_inflation": (0.015, 0.035),
    "bending": (2e-3,),
    "rest_aspect": (0.925, 1.075),
    "section_aspect": (0.925, 1.075),
    "strain_hardening": (0.8,),
    "hooke_share": (1.0,),
    "unsteadiness": (1.5,),
    **{effect: sizes[1:] for effect, sizes in _DRAWN.items() if effect not in _FAINT},
    **{effect: (size,) for effect, size in _OF_FLOW.items()},
}
_PAIRS = (
    (("halo", 0.02), ("pre_inflation", 0.015)),
    (("exposure", 0.05), ("bending", 2e-3)),
    (("pixel_aspect", 1.04), ("pre_inflation", 0.035)),
)
_TAKEN_OUT = (
    *(("pre_inflation", 0.035), ("bending", 2e-3), ("rest_aspect", 1.075), ("exposure", 0.05)),
    ("hooke_share", 1.0),
)
_QUANTILES = (0.8, 0.975)  # of the prior of a user's own effect: its sizes


def _middle(lab: Lab) -> float:
    """Return the mean velocity at the middle flow rate [m/s]."""
    return float(np.sqrt(lab.mean_velocities[0] * lab.mean_velocities[-1]))


@dataclass(frozen=True)
class Cell:
    """Sessions with the same hidden fault."""

    # Sizes are in SI, but the halo is over the half width, and the motion during the exposure and the swelling over the
    # half width at the middle flow rate. A fault is clear if it moves edges by 0.015 l or more, or the apparent G_s of
    # some capsules by 10 % or more relative to others, or the velocity by 8 %.

    name: str
    effect: str  # name of the true effect
    size: float
    known: bool  # whether the catalogue has it
    sessions: int = _SESSIONS
    removed: tuple[str, ...] = ()  # effects taken out of the catalogue
    outline: bool = True  # False if lengths alone are measured
    clear: bool = False
    also: tuple[tuple[str, float], ...] = ()  # further true effects and their sizes
    flow_rates: bool | None = None  # whether the labs state flow rates; None if half of them do
    own: Mapping[str, Effect] = field(default_factory=dict)  # effects of a user's own, tried as well
    own_file: str = ""  # sha256 of the file of these effects

    @property
    def null(self) -> bool:
        """True if there is no effect."""
        return self.effect == "none"

    @property
    def names(self) -> frozenset[str]:
        """Names of all true effects."""
        return frozenset((self.effect, *(name for name, _ in self.also)))

    def drawn(self, seed: int) -> tuple[Lab, int, int]:
        """Draw the laboratory of a session, the number of its capsules, and their seed; other ones in each cell."""
        rng = np.random.default_rng([seed, *self.name.encode()])
        return *drawn_lab(rng, flow_rates=self.flow_rates), int(rng.integers(2**31))

    def size_in(self, lab: Lab) -> float:
        """Return the size of the effect in SI."""
        return _in_si(self.effect, self.size, lab)

    def true_effect(self, lab: Lab) -> TrueEffect:
        """Return all true effects combined; the size is that of `effect`."""
        combined = true_effect_of(self.own[self.effect]) if self.effect in self.own else TRUE_EFFECTS[self.effect]
        for name, size in self.also:
            combined = combined.combined(TRUE_EFFECTS[name], _in_si(name, size, lab))
        return combined

    @property
    def shapes(self) -> tuple[str, float]:
        """Pool of the shapes of its capsules."""
        sizes = ((self.effect, self.size), *self.also)
        return next((pair for pair in sizes if pair in POOLS), ("none", 0.0))

    def candidates(self) -> dict[str, Effect]:
        """Return the effects that the diagnosis of a session tries."""
        return {name: effect for name, effect in {**catalogue(), **self.own}.items() if name not in self.removed}


def _in_si(effect: str, size: float, lab: Lab) -> float:
    return _IN_SI[effect](size, lab) if effect in _IN_SI else size


def _shown(effect: str, size: float) -> str:
    return f"{effect.replace('_', ' ')} {size:g}"


def _cells() -> list[Cell]:
    cells = [
        Cell("nothing", "none", 0.0, True, _NULL_SESSIONS),
        Cell("nothing, lengths alone", "none", 0.0, True, outline=False),
    ]
    simulated = [pair for pair in POOLS if pair[0] != "none"]
    drawn = [(effect, size) for effect, sizes in _DRAWN.items() for size in sizes]
    cells += [
        Cell(_shown(*pair), *pair, True, clear=pair[1] in _CLEAR.get(pair[0], ())) for pair in (*simulated, *drawn)
    ]
    cells += [Cell(_shown(*pair), *pair, True, clear=True, flow_rates=True) for pair in _OF_FLOW.items()]
    cells += [
        Cell(f"{_shown(*first)} with {_shown(*second)}", *first, True, also=(second,), clear=True)
        for first, second in _PAIRS
    ]
    cells += [
        Cell(f"{_shown(*pair)}, not in the catalogue", *pair, False, _UNKNOWN_SESSIONS, removed=pair[:1])
        for pair in _TAKEN_OUT
    ]
    cells += [Cell(f"pattern {size:g}", "pattern", size, False, _UNKNOWN_SESSIONS) for size in (0.01, 0.02)]
    return cells


CELLS = tuple(_cells())
"""All cells of the exam."""


def cells_with(own: Mapping[str, Effect], own_file: str) -> tuple[Cell, ...]:
    """Return all cells with effects of a user's own among those that are tried, and two cells for each of these."""
    cells = [
        Cell(f"{effect.name} {size:.3g}", name, size, True, clear=size == sizes[-1])
        for name, effect in own.items()
        for sizes in [[float(size) for size in effect.prior.ppf(_QUANTILES)]]
        for size in sizes
    ]
    return tuple(replace(cell, own=own, own_file=own_file) for cell in (*cells, *CELLS))
