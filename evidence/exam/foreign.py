"""Faults that the catalogue does not have: of the membrane, of the camera, of the liquid and of the batch.

None of them shares code with an effect of the library.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.diagnosis.blind import Capsule, Lab, Noise, TrueEffect
from capsbayes.physics.membrane import EvansSkalak, GeneralisedHooke, MembraneLaw
from capsbayes.profile import arc_length, edge_lengths, vertex_normals
from evidence.benchmarks.membrane_pools import MooneyRivlin, Ogden

_FINE = 512  # points of an outline that is smoothed
_WAVES = 6  # along the arc of a pattern
_HALF = 0.5  # place in the session of the first capsule of the second recording


def _late(capsule: Capsule) -> bool:
    """Whether a capsule is in the second recording of its session."""
    return capsule.place >= _HALF


def _walls(capsule: Capsule, size: float, lab: Lab, seed: int) -> Capsule:
    """Read the walls too far apart in the second recording: everything looks smaller and slower."""
    if not _late(capsule):
        return capsule
    factor = 1.0 / (1.0 + size)
    return replace(capsule, outline=factor * capsule.outline, velocity_seen=factor * capsule.velocity_seen)


def _focus(capsule: Capsule, size: float, lab: Lab, seed: int) -> Capsule:
    """See all edges too far out in the second recording, by a share of the half width."""
    if not _late(capsule):
        return capsule
    return replace(capsule, outline=capsule.outline + size * vertex_normals(capsule.outline))


def _smoothed(capsule: Capsule, size: float, lab: Lab, seed: int) -> Capsule:
    """Smooth the outline along its arc by a normal kernel, whose standard deviation is over the half width."""
    lengths = edge_lengths(capsule.outline)
    arc, perimeter = np.concatenate([[0.0], np.cumsum(lengths)]), float(lengths.sum())
    even = np.linspace(0.0, perimeter, _FINE, endpoint=False)
    orders = 2.0 * np.pi * np.fft.rfftfreq(_FINE, perimeter / _FINE)
    columns = [
        np.fft.irfft(
            np.fft.rfft(np.interp(even, arc, np.append(column, column[0]))) * np.exp(-0.5 * (size * orders) ** 2)
        )
        for column in capsule.outline.T
    ]
    return replace(capsule, outline=np.stack(columns, axis=1))


def _rear(capsule: Capsule, size: float, lab: Lab, seed: int) -> Capsule:
    """See the rear too far back, by a share of the half width: it is brighter than the nose."""
    outline = capsule.outline
    behind = outline[:, 0] < outline[:, 0].mean()
    shift = size * behind * np.clip(-vertex_normals(outline)[:, 0], 0.0, 1.0) ** 2
    return replace(capsule, outline=outline - np.stack([shift, np.zeros_like(shift)], axis=1))


def _shutter(capsule: Capsule, size: float, lab: Lab, seed: int) -> Capsule:
    """Shear the outline as a rolling shutter does, by the `size` at the middle velocity."""
    usual = np.sqrt(lab.mean_velocities[0] * lab.mean_velocities[-1])
    z, y = capsule.outline.T
    return replace(capsule, outline=np.stack([z + size * capsule.capsule_velocity / usual * y, y], axis=1))


def _drift(capsule: Capsule, size: float, lab: Lab, seed: int) -> Capsule:
    """Let ln of the viscosity rise by the `size` over the session; the mean is that of the laboratory."""
    thicker = np.exp(size * (capsule.place - 0.5))
    numbers = "capsule_velocity", "velocity_seen", "flow_rate"  # at the same Ca
    return replace(capsule, **{name: getattr(capsule, name) / thicker for name in numbers})


def smooth_pattern(outline: Floats, seed: int) -> Floats:
    """Return displacements (p, 2) along the normals: a smooth random function of the arc of unit root mean square."""
    cosines, sines = np.random.default_rng([seed, _WAVES]).standard_normal((2, _WAVES))
    arc = arc_length(outline)
    phase = 2.0 * np.pi * np.outer(arc[:-1] / arc[-1], np.arange(1, _WAVES + 1))
    pattern = (np.cos(phase) @ cosines + np.sin(phase) @ sines) / np.sqrt(0.5 * np.sum(cosines**2 + sines**2))
    return np.asarray(pattern[:, None] * vertex_normals(outline))


def _pattern(capsule: Capsule, size: float, lab: Lab, seed: int) -> Capsule:
    """Move the edge by a pattern of root mean square `size`, common to all capsules."""
    return replace(capsule, outline=capsule.outline + size * smooth_pattern(capsule.outline, seed))


PATTERN = TrueEffect("pattern", drawn=_pattern)
"""What the diagnosis itself takes for something else."""


@dataclass(frozen=True)
class SmoothNoise(Noise):
    """Errors along the outline whose kernel is a squared exponential."""

    def correlation(self, apart: Floats, perimeter: float) -> Floats:
        """Return the correlations at distances along a closed arc, summed over the windings: positive definite."""
        around = np.array([-1.0, 0.0, 1.0]) * perimeter
        length = self.correlation_length * self.longer
        summed, at_zero = (
            np.exp(-0.5 * (np.add.outer(around, distance) / length) ** 2).sum(axis=0)
            for distance in (apart, np.zeros(()))
        )
        return np.asarray(summed / at_zero)


@dataclass(frozen=True)
class TwoBatches(Lab):
    """Laboratory whose capsules are of two batches, as many of each."""

    apart: float = 1.0  # median G_s of one batch over that of the other

    def log_density(self, surface_shear_modulus: Floats, size_ratio: Floats) -> Floats:
        """Return the log density of ln G_s at given a/l, up to a constant; -inf outside the range of sizes."""
        of_one = super().log_density
        each = [of_one(surface_shear_modulus * self.apart**side, size_ratio) for side in (0.5, -0.5)]
        return np.asarray(np.logaddexp(*each))


def _of(law: MembraneLaw, name: str) -> TrueEffect:
    return TrueEffect(name, simulated=lambda size: {"law": law})


LAWS = MappingProxyType(
    {
        "Hooke's law with nu_s = 0": GeneralisedHooke(0.0),
        "Hooke's law with nu_s = 1/3": GeneralisedHooke(1.0 / 3.0),
        "Evans-Skalak law": EvansSkalak(3.0),
        "Mooney-Rivlin law": MooneyRivlin(),
        "Ogden law": Ogden(),
    }
)
"""Membranes that are no members of the general law, by the name of their fault."""

_DRAWN = {
    "walls read wrongly": (_walls, 0.02),
    "focus that changes": (_focus, 0.015),
    "smoothed outlines": (_smoothed, 0.08),
    "rear edge": (_rear, 0.02),
    "rolling shutter": (_shutter, 0.04),
    "viscosity that drifts": (_drift, 0.3),
}
_TWO_BATCHES = TrueEffect("two batches", lab=lambda lab, size: TwoBatches(**vars(lab), apart=size))

FOREIGN = MappingProxyType(
    {name: (_of(law, name), 1.0) for name, law in LAWS.items()}
    | {name: (TrueEffect(name, drawn=drawn), size) for name, (drawn, size) in _DRAWN.items()}
    | {"two batches": (_TWO_BATCHES, 2.0)}
)
"""True effects that the catalogue does not have, and their sizes, by name."""
