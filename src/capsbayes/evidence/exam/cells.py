"""The cells of the exam: sessions that differ in their seeds only."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from capsbayes.effect import Effect, Kind, Theta
from capsbayes.effects import catalogue
from capsbayes.evidence.blind.effects import TRUE_EFFECTS, TrueEffect
from capsbayes.evidence.blind.lab import Lab, Noise
from capsbayes.evidence.blind.operated import true_effect_of
from capsbayes.evidence.blind.optics import smooth_pattern
from capsbayes.evidence.blind.pools import POOLS
from capsbayes.model import ForwardModel
from capsbayes.parameters import Parameter
from capsbayes.prediction import Prediction
from capsbayes.quantity import Quantity

_CAPSULES = 40
_NULLS = {
    "correlated noise": (Noise(), 120),
    "independent noise": (Noise(correlation_length=0.0), 60),
    "heavy tails": (Noise(freedom=4.0), 60),
    "noise understated by 20 %": (Noise(understated=1.2), 60),
    "noise overstated by 20 %": (Noise(understated=0.8), 60),
}
_DRAWN = {  # a small and a clear size of effects that are not simulated, in SI
    "halo": (0.2e-6, 0.5e-6),
    "exposure": (1e-4, 3e-4),
    "pixel_scale": (0.01, 0.025),
    "swelling": (2.5, 6.0),
    "modulus_slope": (0.7, 2.0),
}
_PAIRS = (
    (("halo", 5e-7), ("pre_inflation", 0.015)),
    (("exposure", 3e-4), ("bending", 2e-3)),
    (("pixel_scale", 0.025), ("rest_aspect", 1.075)),
)
_SESSIONS = 24
_QUANTILES = (0.8, 0.975)  # of the prior of a user's own effect: its sizes


@dataclass(frozen=True)
class Decoy:
    """An effect that does not exist, and must explain nothing: a smooth random displacement of the edge.

    Parameters
    ----------
    seed : int
        Of the function.
    """

    seed: int
    name: ClassVar[str] = "random pattern"
    parameter: ClassVar[Parameter] = Parameter("decoy", "d", "d", "-", "-", 1.0, "root mean square displacement over l")
    null_value: ClassVar[float] = 0.0
    kind: ClassVar[Kind] = Kind.SESSION
    circumstances: ClassVar[tuple[str, ...]] = ()
    changes: ClassVar[str] = "Edges are displaced by a random pattern."
    separated_by: ClassVar[str] = "None: it is not in the channel."
    prior: ClassVar[Quantity] = Quantity(0.0, 0.02, low=-np.inf)

    def __call__(self, model: ForwardModel, theta: Theta, *, outline: bool = False) -> Prediction:
        """Displace the edges that a model predicts, and with them the ends of its lengths."""
        plain = model(theta, outline=True)
        assert plain.outline is not None, "asked for"
        moved = plain.outline.copy()
        for row in np.flatnonzero(plain.inside):
            moved[row] += theta["decoy"][row] * smooth_pattern(moved[row], self.seed)
        nose, rear = (moved[:, place, 0] - plain.outline[:, place, 0] for place in (0, moved.shape[1] // 2))
        longer = np.ptp(moved[..., 0], axis=1) - np.ptp(plain.outline[..., 0], axis=1)
        return replace(
            plain,
            axial_extent=plain.axial_extent + longer,
            axial_length=plain.axial_length + nose - rear,
            outline=moved if outline else None,
        )


@dataclass(frozen=True)
class Cell:
    """Sessions with the same true effect.

    Parameters
    ----------
    name : str
    effect : str
        Name of the true effect.
    size : float
        In SI.
    known : bool
        True if the catalogue has the effect.
    sessions, capsules : int
        Number of sessions, and of capsules in each.
    lab : Lab
    removed : tuple of str
        Effects taken out of the catalogue.
    outline : bool
        False if lengths alone are measured.
    clear : bool
        True if the effect moves edges by 0.02 l or more, or the apparent G_s of some capsules by 10 % or more relative
        to others.
    also : tuple of (str, float)
        Further true effects and their sizes.
    decoy : bool
        True if the only candidate is a random pattern.
    own : mapping of str to Effect
        Effects of a user's own by name of their parameter, tried as well.
    own_file : str
        sha256 of the file of these effects.
    """

    name: str
    effect: str
    size: float
    known: bool
    sessions: int = _SESSIONS
    capsules: int = _CAPSULES
    lab: Lab = field(default_factory=Lab)
    removed: tuple[str, ...] = ()
    outline: bool = True
    clear: bool = False
    also: tuple[tuple[str, float], ...] = ()
    decoy: bool = False
    own: Mapping[str, Effect] = field(default_factory=dict)
    own_file: str = ""

    @property
    def null(self) -> bool:
        """True if there is no effect."""
        return self.effect == "none"

    @property
    def sizes(self) -> dict[str, float]:
        """Sizes of all true effects, by name."""
        return {self.effect: self.size, **dict(self.also)}

    @property
    def true_effect(self) -> TrueEffect:
        """All true effects combined; the size is that of `effect`."""
        combined = true_effect_of(self.own[self.effect]) if self.effect in self.own else TRUE_EFFECTS[self.effect]
        for name, size in self.also:
            combined = combined.combined(TRUE_EFFECTS[name], size)
        return combined

    @property
    def shapes(self) -> tuple[str, float]:
        """Pool of the shapes of its capsules."""
        return next((pair for pair in self.sizes.items() if pair in POOLS), ("none", 0.0))

    def candidates(self, seed: int) -> dict[str, Effect]:
        """Return the effects that the diagnosis of a session tries."""
        if self.decoy:
            return {Decoy.parameter.name: Decoy(seed)}
        return {name: effect for name, effect in {**catalogue(), **self.own}.items() if name not in self.removed}


def _cells() -> list[Cell]:
    cells = [
        Cell(f"nothing, {name}", "none", 0.0, True, sessions, lab=Lab(noise=noise))
        for name, (noise, sessions) in _NULLS.items()
    ]
    cells.append(Cell("nothing, lengths alone", "none", 0.0, True, 60, outline=False))
    simulated = [pair for pair in POOLS if pair[0] not in ("none", "hooke")]
    drawn = [(effect, size) for effect, sizes in _DRAWN.items() for size in sizes]
    shown = {effect: effect.replace("_", " ") for effect in TRUE_EFFECTS}
    large = [(effect, sizes[1]) for effect, sizes in _DRAWN.items()]
    cells += [
        Cell(f"{shown[effect]} {size:g}", effect, size, True, clear=(effect, size) in large)
        for effect, size in (*simulated, *drawn)
    ]
    cells += [
        Cell(f"{shown[effect]} {size:g}, not in the catalogue", effect, size, False, removed=(effect,))
        for effect, size in (("pre_inflation", 0.035), ("bending", 2e-3), ("rest_aspect", 1.075), ("exposure", 3e-4))
    ]
    cells += [
        Cell(
            f"{shown[effect]} {size:g} with {shown[other]} {other_size:g}",
            effect,
            size,
            True,
            also=((other, other_size),),
        )
        for (effect, size), (other, other_size) in _PAIRS
    ]
    cells += [
        Cell(f"{shown[effect]} {size:g}, a random pattern tried", effect, size, False, decoy=True)
        for effect, size in (("pre_inflation", 0.035), ("bending", 2e-3), ("halo", 5e-7))
    ]
    cells += [Cell(f"pattern {size:g}", "pattern", size, False) for size in (0.01, 0.02)]
    return [*cells, Cell("generalised Hooke membrane", "hooke", 0.5, False)]


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
