"""What the exam asks: cells of sessions alike but for their seeds."""

from __future__ import annotations

from dataclasses import dataclass, field

from capsbayes.evidence.blind.hideable import HIDEABLE, Hideable
from capsbayes.evidence.blind.lab import Lab, Noise
from capsbayes.evidence.blind.pools import POOLS

__all__ = ["CELLS", "Cell"]

_CAPSULES = 40
_NULLS = {
    "correlated noise": (Noise(), 120),
    "independent noise": (Noise(correlation_length=0.0), 60),
    "heavy tails": (Noise(freedom=4.0), 60),
    "noise understated by 20 %": (Noise(understated=1.2), 60),
    "noise overstated by 20 %": (Noise(understated=0.8), 60),
}
_DRAWN = {  # a small and a clear size of what is not simulated, in SI
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


@dataclass(frozen=True)
class Cell:
    """Sessions with the same thing hidden in them.

    Parameters
    ----------
    name : str
    effect : str
        Name of what is hidden.
    size : float
        In SI.
    known : bool
        Whether the catalogue has it.
    sessions, capsules : int
    lab : Lab
    removed : tuple of str
        Effects taken out of the catalogue.
    outline : bool
        Whether outlines are measured, or lengths alone.
    clear : bool
        Whether it moves edges by 0.02 l or more, or the apparent G_s of some capsules by 10 % or more beside others.
    also : tuple of (str, float)
        What else is hidden, and its size.
    decoy : bool
        Whether a random pattern is all that is tried.
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

    @property
    def null(self) -> bool:
        """Whether nothing is hidden."""
        return self.effect == "none"

    @property
    def sizes(self) -> dict[str, float]:
        """Of all that is hidden, by name."""
        return {self.effect: self.size, **dict(self.also)}

    @property
    def hidden(self) -> Hideable:
        """All that is hidden, its size that of `effect`."""
        found = HIDEABLE[self.effect]
        for name, size in self.also:
            found = found.beside(HIDEABLE[name], size)
        return found

    @property
    def shapes(self) -> tuple[str, float]:
        """The pool of shapes from which its capsules come."""
        return next((pair for pair in self.sizes.items() if pair in POOLS), ("none", 0.0))


def _cells() -> list[Cell]:
    cells = [
        Cell(f"nothing, {name}", "none", 0.0, True, sessions, lab=Lab(noise=noise))
        for name, (noise, sessions) in _NULLS.items()
    ]
    cells.append(Cell("nothing, lengths alone", "none", 0.0, True, 60, outline=False))
    simulated = [pair for pair in POOLS if pair[0] not in ("none", "hooke")]
    drawn = [(effect, size) for effect, sizes in _DRAWN.items() for size in sizes]
    shown = {effect: _shown(effect) for effect in HIDEABLE}
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
        Cell(f"{shown[one]} {size:g} with {shown[other]} {other_size:g}", one, size, True, also=((other, other_size),))
        for (one, size), (other, other_size) in _PAIRS
    ]
    cells += [
        Cell(f"{shown[effect]} {size:g}, a random pattern tried", effect, size, False, decoy=True)
        for effect, size in (("pre_inflation", 0.035), ("bending", 2e-3), ("halo", 5e-7))
    ]
    cells += [Cell(f"pattern {size:g}", "pattern", size, False) for size in (0.01, 0.02)]
    return [*cells, Cell("generalised Hooke membrane", "hooke", 0.5, False)]


def _shown(effect: str) -> str:
    return effect.replace("_", " ")


CELLS = tuple(_cells())
"""All of the exam."""
