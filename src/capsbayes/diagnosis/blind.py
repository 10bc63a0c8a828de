"""Blind sessions: measured capsules drawn from simulated shapes, with a true effect that a plain model lacks.

The shapes come from the simulator itself, at parameters between those of the databases that models are made of and on
another mesh. What a microscope adds is drawn on their outlines as geometry. This file reads no model and no operator of
an effect of the library, so that what is found again was not put in by the same code. Only an effect of a user's own is
put in by its operator.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np
import shapely
from numpy.typing import ArrayLike
from shapely.affinity import scale
from shapely.geometry import Polygon
from shapely.geometry.base import BaseGeometry
from shapely.geometry.polygon import orient

from capsbayes.arrays import Booleans, Floats
from capsbayes.database import Database
from capsbayes.diagnosis.session import Session
from capsbayes.errors import InputError
from capsbayes.experiment import Experiment, capillary_number, capsule_radius, surface_shear_modulus
from capsbayes.measurement import MeasuredOutline, Measurement, OutlineNoise
from capsbayes.model import Domain, Effect, ForwardModel, Theta
from capsbayes.physics.build import SteadySimulator, build_database
from capsbayes.physics.channel import cross_section_named
from capsbayes.physics.membrane import GeneralisedHooke, HookeShare, Skalak, StrainHardening
from capsbayes.physics.simulator import Simulator, UnsteadySimulator
from capsbayes.prediction import Prediction
from capsbayes.profile import Profile, arc_length, vertex_normals, with_extent
from capsbayes.quantity import Quantity

# The laboratory: its channel, its liquid, its capsules, and its errors of measurement


@dataclass(frozen=True)
class Noise:
    """Errors of measurement, and what the lab states of them."""

    scale: float = 0.01  # stated standard deviation of an edge's error along the normal, over l
    correlation_length: float = 0.2  # of the errors along the outline, over l; zero for independent errors
    velocity: float = 0.01  # relative standard error of a capsule's velocity
    understated: float = 1.0  # true standard deviation over the stated one
    freedom: float | None = None  # of Student's t, which scales the errors of whole capsules; None for Gaussian errors
    points: int = 48  # vertices of a measured outline
    longer: float = 1.0  # true correlation length over the stated one

    def correlation(self, apart: Floats, perimeter: float) -> Floats:
        """Return the correlations of errors at distances along a closed arc, as the likelihood assumes them."""
        length = self.correlation_length * self.longer
        return np.asarray(np.exp(-np.minimum(apart, perimeter - apart) / length))


@dataclass(frozen=True)
class Lab:
    """Channel, liquid, flow rates and population of capsules."""

    half_width: float = 25e-6  # [m]
    half_width_error: float = 0.25e-6
    viscosity: float = 0.8  # [Pa s]
    viscosity_error: float = 0.02
    mean_velocities: tuple[float, ...] = (2.6e-3, 3.2e-3, 4.0e-3, 5.0e-3)  # [m/s], one a flow rate
    surface_shear_modulus: float = 0.05  # [N/m], median in the middle of `size_ratios`
    spread: float = 0.1  # standard deviation of ln G_s between capsules
    slope: float = 0.0  # d ln G_s / d ln a
    size_ratios: tuple[float, float] = (0.79, 0.98)  # range of a/l, which is uniform there
    noise: Noise = field(default_factory=Noise)
    flow_rate_error: float | None = None  # relative, common to all; None if the lab does not state flow rates
    viscosity_stated: float = 1.0  # over the true one

    def stated_over_true_flow(self, rng: np.random.Generator) -> float | None:
        """Draw the stated flow rate over that which the nominal width and the true U give; None if not stated."""
        # Both the flow rate and the width are wrong within their errors.
        if self.flow_rate_error is None:
            return None
        width = rng.normal(1.0, self.half_width_error / self.half_width)
        return float(rng.normal(1.0, self.flow_rate_error) * width**2)

    @property
    def experiment(self) -> Experiment:
        """The channel and the liquid as the lab knows them."""
        return Experiment(
            cross_section="square",
            half_width=Quantity(self.half_width, self.half_width_error),
            viscosity=Quantity(self.viscosity * self.viscosity_stated, self.viscosity_error),
        )

    def log_density(self, surface_shear_modulus: Floats, size_ratio: Floats) -> Floats:
        """Return the log density of ln G_s at given a/l, up to a constant; -inf outside the range of sizes."""
        low, high = self.size_ratios
        deviation = (np.log(surface_shear_modulus) - self._median(size_ratio)) / self.spread
        return np.where((size_ratio >= low) & (size_ratio <= high), -0.5 * deviation**2, -np.inf)

    def drawn(self, rng: np.random.Generator, count: int) -> tuple[Floats, Floats, Floats]:
        """Draw G_s [N/m], a/l and U [m/s] of capsules : (count,) arrays."""
        low, high = self.size_ratios
        size = rng.uniform(low, high, count)
        modulus = np.exp(self._median(size) + self.spread * rng.standard_normal(count))
        return modulus, size, rng.choice(np.array(self.mean_velocities), count)

    def _median(self, size_ratio: Floats) -> Floats:
        """Return the median of ln G_s at given a/l."""
        relative = size_ratio / np.mean(self.size_ratios)
        return np.asarray(np.log(self.surface_shear_modulus) + self.slope * np.log(relative))


# Changes of an outline by a microscope, as plane geometry; outlines are (p, 2) arrays

_ROUND = 64  # segments of a quarter of a circle


def grown(outline: Floats, distance: float) -> Floats:
    """Return the outline of all points within a distance of the capsule; it shrinks if the distance is negative."""
    return _edge(Polygon(outline).buffer(distance, quad_segs=_ROUND))


def smeared(outline: Floats, length: float) -> Floats:
    """Return the outline of the area that the capsule covers while it moves by a length along the flow."""
    if length == 0.0:
        return outline
    half = np.array([0.5 * length, 0.0])
    following = np.roll(outline, -1, axis=0)
    swept = np.stack([outline - half, outline + half, following + half, following - half], axis=1)
    swaths = np.asarray(shapely.make_valid(shapely.polygons(swept)))
    ends = np.array([Polygon(outline - half), Polygon(outline + half)])
    return _edge(shapely.union_all(np.concatenate([swaths, ends])))


def enlarged(outline: Floats, along: float, across: float) -> Floats:
    """Return the outline scaled about the origin, along the flow and across it."""
    return _edge(scale(Polygon(outline), along, across, origin=(0.0, 0.0)))


def distorted(outline: Floats, size: float) -> Floats:
    """Return the outline in the middle of a picture that a lens distorts, over the half width as seen there."""
    # A point at a distance r from the middle is seen at r (1 + size r^2).
    return _pictured(outline, lambda at: at * (1.0 + size * np.sum(at**2, axis=1, keepdims=True)) / (1.0 + size))


def in_perspective(outline: Floats, size: float) -> Floats:
    """Return the outline in the middle of a picture of a tilted plane."""
    # Along a half width downstream the plane comes nearer to the lens by the share `size` of its distance.
    return _pictured(outline, lambda at: at / (1.0 - size * at[:, :1]))


def _pictured(outline: Floats, seen: Callable[[Floats], Floats]) -> Floats:
    """Return the outline in the middle of a picture, as `seen` maps places from there."""
    middle = np.mean(Polygon(outline).bounds[::2])
    return _edge(shapely.transform(Polygon(outline), lambda points: np.asarray(seen(points - [middle, 0.0]))))


def _edge(area: BaseGeometry) -> Floats:
    """Return the vertices of the outer edge of a polygon, counterclockwise in the plane (z, y)."""
    assert isinstance(area, Polygon), "one piece"
    ring = orient(area).exterior
    return np.asarray(ring.coords, dtype=np.float64)[:-1]


# One capsule, and its measurement with errors

_LEAST_INDEPENDENT = 1e-9  # share of the variance that keeps a covariance definite
_TILT, _SHIFT = 0.01, 0.05  # rad, l


@dataclass(frozen=True, eq=False)
class Capsule:
    """A capsule in the channel."""

    capillary_number: float  # in the true channel, at the place of the capsule
    size_ratio: float  # in the true channel
    surface_shear_modulus: float  # [N/m]
    capsule_radius: float  # [m]
    capsule_velocity: float  # [m/s], true
    velocity_seen: float  # [m/s], as the microscope shows it, without random errors
    flow_rate: float  # [m^3/s], as the pump shows it, without random errors
    outline: Floats  # (p, 2): edge in the mid-plane as seen, over the lab's half width; columns (z, y), from the nose
    row: int = 0  # of its shape among the converged ones of the database
    place: float = 0.0  # in the order of filming, from 0 to 1

    def measured(
        self,
        noise: Noise,
        rng: np.random.Generator,
        *,
        outline: bool,
        source: str,
        flow_rate: tuple[float, float] | None = None,
    ) -> Measurement:
        """Return the measurement of the capsule under the name `source`, with its outline or with the lengths alone."""
        # A flow rate is stated if the stated one over that of the pump is given, and its relative standard error.
        factor, relative = flow_rate or (0.0, 0.0)
        seen = Profile.from_outline(self.outline).resampled(4 * noise.points)
        start = int(rng.integers(4))
        normals = vertex_normals(seen.points)[start::4]
        errors = edge_errors(seen.points[start::4], noise, rng)
        edge = seen.points[start::4] + errors[:, None] * normals
        extent, length = _lengths(seen, edge, errors)
        velocity = self.velocity_seen * rng.normal(1.0, noise.velocity)
        return Measurement(
            extent,
            np.sqrt(2.0) * noise.scale,
            velocity,
            noise.velocity * velocity,
            length,
            np.sqrt(2.0) * noise.scale,
            length_correlation=0.5,
            outline=_posed(edge, noise, rng) if outline else None,
            source=source,
            flow_rate=factor * self.flow_rate if flow_rate else None,
            flow_rate_error=relative * factor * self.flow_rate if flow_rate else None,
        )


def edge_errors(points: Floats, noise: Noise, rng: np.random.Generator) -> Floats:
    """Draw the errors (m,) of vertices (m, 2) along their normals."""
    # They are a Gaussian process on the arc, whose scale differs from capsule to capsule where the noise has heavy
    # tails.
    arc = arc_length(points)
    apart = np.abs(np.subtract.outer(arc[:-1], arc[:-1]))
    same = np.eye(len(points))
    smooth = noise.correlation(apart, arc[-1]) if noise.correlation_length else same
    smooth = smooth + _LEAST_INDEPENDENT * same
    size = noise.understated * noise.scale
    if noise.freedom is not None:
        size *= np.sqrt((noise.freedom - 2.0) / rng.chisquare(noise.freedom))
    # along the Cholesky factor: the signs of eigenvectors depend on the processor
    return np.asarray(size * (np.linalg.cholesky(smooth) @ rng.standard_normal(len(smooth))))


def _lengths(seen: Profile, edge: Floats, errors: Floats) -> tuple[float, float]:
    """Return L_z and L_a as read at three places of the edge: nose, rearmost point, rear on the axis."""
    upper = seen.points[: len(seen.points) // 2 + 1]  # of two rearmost points always the same one
    places = upper[0], upper[np.argmin(upper[:, 0])], upper[-1]
    nose, rim, middle = (errors[np.argmin(np.hypot(*(edge - place).T))] for place in places)
    extent = seen.axial_extent + nose + rim
    return float(extent), float(min(seen.axial_length + nose + middle, extent))


def _posed(edge: Floats, noise: Noise, rng: np.random.Generator) -> MeasuredOutline:
    """Return the outline slightly tilted and shifted, as in a picture."""
    angle = _TILT * rng.standard_normal()
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    placed = edge @ turn + _SHIFT * rng.standard_normal(2)
    return MeasuredOutline(placed, OutlineNoise(noise.scale, noise.correlation_length))


# True effects: in the simulation, in the picture, or in the population of capsules

Drawn = Callable[[Capsule, float, Lab, int], Capsule]


@dataclass(frozen=True)
class TrueEffect:
    """An effect that the capsules of a blind session have, and a plain model lacks."""

    name: str  # of the parameter of the catalogue's effect, if the catalogue has it
    unit: str = ""  # of its size in SI, empty for a ratio
    simulated: Callable[[float], dict[str, Any]] = lambda size: {}  # settings of the simulator that it changes
    drawn: Drawn = lambda capsule, size, lab, seed: capsule  # as the microscope shows it
    lab: Callable[[Lab, float], Lab] = lambda lab, size: lab  # the change of the population

    def combined(self, other: TrueEffect, other_size: float) -> TrueEffect:
        """Return this effect together with another of a given size, which acts first."""
        return replace(
            self,
            simulated=lambda size: {**other.simulated(other_size), **self.simulated(size)},
            drawn=lambda capsule, size, lab, seed: self.drawn(
                other.drawn(capsule, other_size, lab, seed), size, lab, seed
            ),
            lab=lambda lab, size: self.lab(other.lab(lab, other_size), size),
        )


def _setting(name: str) -> TrueEffect:
    return TrueEffect(name, simulated=lambda size: {name: size})


def _outline(name: str, change: Callable[[Floats, float], Floats]) -> TrueEffect:
    """Return an effect that changes the outline alone, by its size alone."""
    return TrueEffect(name, drawn=lambda capsule, size, *_: replace(capsule, outline=change(capsule.outline, size)))


def _factor(name: str, number: str) -> TrueEffect:
    """Return an effect that makes a number of the capsule larger by a share."""
    return TrueEffect(
        name, drawn=lambda capsule, size, *_: replace(capsule, **{number: getattr(capsule, number) * (1.0 + size)})
    )


def _magnified(capsule: Capsule, along: float, across: float) -> Capsule:
    """Show the capsule with other pixels, by which its velocity along the flow is measured too."""
    return replace(
        capsule, outline=enlarged(capsule.outline, along, across), velocity_seen=capsule.velocity_seen * along
    )


def _swollen(capsule: Capsule, size: float, lab: Lab, seed: int) -> Capsule:
    """Enlarge the capsule: it was simulated in the true channel, and the lab divides by the nominal half width."""
    factor = 1.0 + size * capsule.capsule_velocity
    return replace(
        capsule,
        outline=enlarged(capsule.outline, factor, factor),
        capsule_radius=capsule.capsule_radius * factor,
        flow_rate=capsule.flow_rate * factor**2,
    )


def _narrower(capsule: Capsule, size: float, lab: Lab, seed: int) -> Capsule:
    """Put the capsule into a channel narrower than the lab's value of it, which scales velocities in the picture."""
    factor = 1.0 + size
    return replace(
        capsule,
        capsule_radius=capsule.capsule_radius / factor,
        flow_rate=capsule.flow_rate / factor**2,
        velocity_seen=capsule.velocity_seen * factor,
    )


def _narrower_than_divided(capsule: Capsule, size: float, lab: Lab, seed: int) -> Capsule:
    """Put the capsule into a channel narrower than the lab's value of it, by which lengths in metres are divided."""
    factor = 1.0 + size
    return replace(
        capsule,
        outline=enlarged(capsule.outline, 1.0 / factor, 1.0 / factor),
        capsule_radius=capsule.capsule_radius / factor,
        flow_rate=capsule.flow_rate / factor**2,
    )


_EFFECTS = (
    TrueEffect("none"),
    *map(_setting, ("pre_inflation", "bending", "rest_aspect", "corner_radius", "unsteadiness")),
    TrueEffect("section_aspect", simulated=lambda size: {"cross_section": "rectangular", "section_aspect": size}),
    TrueEffect("hardening", simulated=lambda size: {"law": Skalak(hardening=size)}),
    TrueEffect("strain_hardening", simulated=lambda size: {"law": StrainHardening(strain_hardening=size)}),
    TrueEffect("hooke_share", simulated=lambda size: {"law": HookeShare(size) if size < 1.0 else GeneralisedHooke()}),
    TrueEffect(
        "halo",
        "m",
        drawn=lambda capsule, size, lab, _: replace(capsule, outline=grown(capsule.outline, size / lab.half_width)),
    ),
    TrueEffect(
        "exposure",
        "s",
        drawn=lambda capsule, size, lab, _: replace(
            capsule, outline=smeared(capsule.outline, size * capsule.capsule_velocity / lab.half_width)
        ),
    ),
    TrueEffect("pixel_scale", drawn=lambda capsule, size, *_: _magnified(capsule, 1.0 + size, 1.0 + size)),
    TrueEffect("pixel_aspect", drawn=lambda capsule, size, *_: _magnified(capsule, size, 1.0)),
    _outline("distortion", distorted),
    _outline("taper", in_perspective),
    TrueEffect("swelling", "s/m", drawn=_swollen),
    _factor("velocity_scale", "velocity_seen"),
    _factor("flow_rate_error", "flow_rate"),
    TrueEffect("half_width_error", drawn=_narrower),
    TrueEffect("half_width_apart", drawn=_narrower_than_divided),
    TrueEffect("modulus_slope", lab=lambda lab, size: replace(lab, slope=size)),
)

TRUE_EFFECTS = MappingProxyType({effect.name: effect for effect in _EFFECTS})
"""All true effects by name."""


def true_effect_named(name: str, own: Mapping[str, TrueEffect] = MappingProxyType({})) -> TrueEffect:
    """Return the true effect of a name, with hyphens or blanks for underscores; `own` ones are known too."""
    effects = {**TRUE_EFFECTS, **own}
    known = name.strip().lower().replace("-", "_").replace(" ", "_")
    if known not in effects:
        raise InputError("hide", "effect", f"one of {', '.join(effects)}", repr(name))
    return effects[known]


# True effects made from the operators of a user's own effects, applied to simulated shapes


def true_effect_of(effect: Effect) -> TrueEffect:
    """Return an effect whose operator acts on the simulated shape and velocity of each capsule."""
    # What is found again was put in by the same code then: a session tells whether the effect can be found and
    # distinguished, not whether its operator is right.

    name, unit = effect.parameter.name, effect.parameter.unit
    return TrueEffect(
        name,
        "" if unit == "-" else unit,
        drawn=lambda capsule, size, lab, _: _operated(effect, capsule, size, lab),
    )


def _operated(effect: Effect, capsule: Capsule, size: float, lab: Lab) -> Capsule:
    speed = capsule.capillary_number * capsule.surface_shear_modulus / lab.viscosity
    theta = {
        "capillary_number": capsule.capillary_number,
        "size_ratio": capsule.size_ratio,
        "capsule_velocity": capsule.velocity_seen,
        "mean_velocity": speed,
        "half_width": lab.half_width,
        "viscosity": lab.viscosity,
        "flow_rate": capsule.flow_rate,
        effect.parameter.name: size,
    }
    model = _OneCapsule(capsule, capsule.velocity_seen / speed)
    seen = (model + effect)({name: np.array([value]) for name, value in theta.items()}, outline=True)
    if seen.outline is None or not np.isfinite(seen.outline).all():
        raise InputError("hide", effect.parameter.name, "a size at which capsules have outlines", f"{size:g}")
    return replace(capsule, outline=seen.outline[0], velocity_seen=float(seen.velocity_ratio[0]) * speed)


@dataclass(frozen=True)
class _Everywhere(Domain):
    """All shapes that a channel can hold."""

    @property
    def bounds(self) -> tuple[tuple[float, float], tuple[float, float]]:
        return (1e-6, 10.0), (1e-3, 10.0)

    def contains(self, capillary_number: ArrayLike, size_ratio: ArrayLike, *coordinates: ArrayLike) -> Booleans:
        return np.isfinite(np.asarray(capillary_number) + np.asarray(size_ratio))


@dataclass(frozen=True, eq=False)
class _OneCapsule(ForwardModel):
    """Simulated shape and velocity of one capsule; no other was simulated."""

    capsule: Capsule
    velocity_ratio: float
    name: str = field(default="one simulated capsule", init=False)
    sha256: str = field(default="0", init=False)
    domain: Domain = field(default=_Everywhere(), init=False)

    def __call__(self, theta: Theta, *, outline: bool = False) -> Prediction:
        self.check_names(theta)
        capsule = self.capsule
        for name in ("capillary_number", "size_ratio"):
            asked, known = float(theta[name][0]), getattr(capsule, name)
            if not np.isclose(asked, known, rtol=1e-9):
                expected = "an effect on the picture or the velocity of a capsule"
                got = f"one for which it would be simulated at another {name}, {asked:.4g} in place of {known:.4g}"
                raise InputError("hide", "effect", expected, got)
        shape = Profile.from_outline(capsule.outline)
        one = np.ones(1)
        return Prediction(
            axial_extent=shape.axial_extent * one,
            axial_length=shape.axial_length * one,
            velocity_ratio=self.velocity_ratio * one,
            stretch_ratio=shape.stretch_ratio(capsule.size_ratio) * one,
            covariance=np.zeros((1, 3, 3)),
            inside=np.ones(1, bool),
            outline=capsule.outline[None] if outline else None,
        )


# Simulators with a true effect, and the shapes that they gave

_REFINEMENT = 12  # on a coarser mesh the truth itself is wrong: at 10, L_z by 0.006 l at Ca 0.107


def simulator_with(effect: TrueEffect, size: float, refinement: int = _REFINEMENT) -> SteadySimulator:
    """Return the simulator of a neo-Hookean capsule in a square channel with a true effect."""
    changed = dict(effect.simulated(size))
    unsteadiness = changed.pop("unsteadiness", 0.0)
    simulator = replace(Simulator(refinement=refinement), **changed)
    return UnsteadySimulator(simulator, unsteadiness) if unsteadiness else simulator


def read_shapes(path: str | os.PathLike[str], effect: TrueEffect, size: float) -> Database:
    """Return the database of a file, on whatever mesh, as the shapes of capsules with a true effect."""
    shapes = Database.read(path)
    different = set(different_settings(shapes, simulator_with(effect, size))) - {"refinement"}
    if different:
        expected, advice = "shapes that were simulated with the effect", "omit --shapes"
        raise InputError(str(path), "", expected, f"ones with other {', '.join(sorted(different))}", advice)
    return shapes


def different_settings(pool: Database, simulator: SteadySimulator) -> list[str]:
    """Return the names of the settings that a database does not share with a simulator."""
    asked, known = json.loads(json.dumps(dict(simulator.settings))), pool.settings
    return sorted(key for key in {*asked, *known} if asked.get(key) != known.get(key))


# Sessions drawn from stored shapes, or simulated capsule by capsule, with their truth

_TYPICAL = -4.5  # log density relative to its maximum: three standard deviations
_SPARE = 1.15  # simulated capsules for each one wanted, since some have no steady shape
_DIGITS = 6  # of Ca and a/l, so that a case can be found again
_LOWEST = 0.02  # Ca, below which two shapes may be stable


@dataclass(frozen=True, eq=False)
class BlindSession:
    """The measurements of a lab, and the truth that it does not know."""

    session: Session
    effect: str  # name of the true effect, "none" if there is none
    size: float  # of the effect, in SI
    seed: int
    lab: Lab
    capsules: tuple[Capsule, ...]
    shapes: str  # sha256 of the database of shapes
    log_modulus_of_batch: float  # ln of the median G_s [N/m] of the capsules among which these were drawn

    @property
    def log_modulus(self) -> Floats:
        """ln G_s of the capsules [N/m] : (n,) array."""
        return np.log([capsule.surface_shear_modulus for capsule in self.capsules])

    def truth(self) -> dict[str, Any]:
        """Return the whole truth in SI, as JSON can hold it."""
        numbers = ("surface_shear_modulus", "capsule_radius", "capillary_number", "size_ratio", "capsule_velocity")
        capsules = [{name: float(getattr(capsule, name)) for name in numbers} for capsule in self.capsules]
        known = {"effect": self.effect, "size": self.size, "seed": self.seed, "shapes_sha256": self.shapes}
        return {**known, "lab": asdict(self.lab), "capsules": capsules}


def draw_session(
    shapes: Database, effect: TrueEffect, size: float, *, lab: Lab, capsules: int, seed: int, outline: bool = True
) -> BlindSession:
    """Draw a session of some capsules from stored shapes, measured with their outlines or by the lengths alone."""
    # Capsules are drawn among all pairs of a shape and a flow rate, with the probability density of the lab's
    # population there; the pair determines G_s. The shapes were simulated with the effect if it acts on the simulation;
    # its size is in SI.
    rng = np.random.default_rng(seed)
    pairs, median = _pairs(shapes.converged, effect.lab(lab, size), capsules, rng)
    return _measured(shapes, pairs, effect, size, lab, seed, outline, rng, median)


def simulate_session(
    effect: TrueEffect,
    size: float,
    *,
    lab: Lab,
    capsules: int,
    seed: int,
    shapes: str | os.PathLike[str],
    outline: bool = True,
    refinement: int = _REFINEMENT,
    workers: int | None = None,
) -> BlindSession:
    """Draw some capsules from a lab's population, simulate each at its own Ca and size, and measure them."""
    # The database at the path `shapes` keeps the shapes: the same call repeated continues from those that are finished.
    # The size of the effect is in SI; without `outline`, lengths alone are measured.
    rng = np.random.default_rng(seed)
    modulus, size_ratio, speed = effect.lab(lab, size).drawn(rng, int(np.ceil(_SPARE * capsules)))
    ca = capillary_number(viscosity=lab.viscosity, mean_velocity=speed, surface_shear_modulus=modulus)
    cases = list(zip(np.round(np.maximum(ca, _LOWEST), _DIGITS), np.round(size_ratio, _DIGITS), strict=True))
    built = build_database(simulator_with(effect, size, refinement), cases, out=shapes, workers=workers).converged
    rows = [_row(built, *case) for case in cases]
    pairs = [(row, float(velocity)) for row, velocity in zip(rows, speed, strict=True) if row is not None][:capsules]
    if len(pairs) < capsules:
        advice = "let them be softer or smaller"
        raise InputError("blind session", "capsules", f"{capsules} with a steady shape", f"{len(pairs)}", advice)
    median = float(np.log(lab.surface_shear_modulus))
    return _measured(built, pairs, effect, size, lab, seed, outline, rng, median)


def _measured(
    shapes: Database,
    pairs: Sequence[tuple[int, float]],
    effect: TrueEffect,
    size: float,
    lab: Lab,
    seed: int,
    outline: bool,
    rng: np.random.Generator,
    median: float,
) -> BlindSession:
    """Return the session of capsules with converged shapes, given by their rows, each at a mean velocity."""
    converged = shapes.converged
    places = np.linspace(0.0, 1.0, len(pairs)).tolist()
    capsules = [
        effect.drawn(replace(_capsule(converged, row, speed, lab), place=place), size, lab, seed)
        for place, (row, speed) in zip(places, pairs, strict=True)
    ]
    factor = lab.stated_over_true_flow(rng)
    stated = None if factor is None else (factor, lab.flow_rate_error or 0.0)
    taken = partial(_in_a_picture, lab.noise, rng, outline=outline, flow_rate=stated)
    measurements = [taken(capsule, source=f"capsule {number:03d}") for number, capsule in enumerate(capsules, start=1)]
    session = Session(measurements, lab.experiment)
    return BlindSession(session, effect.name, size, seed, lab, tuple(capsules), shapes.sha256, median)


def _in_a_picture(noise: Noise, rng: np.random.Generator, capsule: Capsule, **how: Any) -> Measurement:
    """Measure a capsule, once more where errors of its edge made it cross itself, which no picture shows."""
    measured = capsule.measured(noise, rng, **how)
    try:
        measured.check_outline(measured.source)
    except InputError:
        return capsule.measured(noise, rng, **how)
    return measured


def _pairs(shapes: Database, lab: Lab, count: int, rng: np.random.Generator) -> tuple[list[tuple[int, float]], float]:
    """Draw the row of a shape and the mean velocity of each capsule, no pair twice; return the median ln G_s of all."""
    speeds = np.array(lab.mean_velocities)
    modulus = surface_shear_modulus(
        viscosity=lab.viscosity, mean_velocity=speeds, capillary_number=shapes["capillary_number"][:, None]
    )
    density = np.exp(lab.log_density(modulus, shapes["size_ratio"][:, None])).ravel()
    possible = int(np.sum(density > np.exp(_TYPICAL)))
    if possible < count:
        expected = f"shapes for {count} capsules"
        raise InputError("blind session", "shapes", expected, f"{possible} pairs of a shape and a flow rate")
    places = rng.choice(density.size, count, replace=False, p=density / density.sum())
    order = np.argsort(modulus, axis=None)
    below = np.cumsum(density[order])
    median = float(np.log(modulus.ravel()[order][np.searchsorted(below, 0.5 * below[-1])]))
    return [(int(place) // len(speeds), float(speeds[place % len(speeds)])) for place in places], median


def _row(shapes: Database, capillary_number: float, size_ratio: float) -> int | None:
    """Return the row of a case, None if it has no steady shape."""
    same = np.isclose(shapes["capillary_number"], capillary_number) & np.isclose(shapes["size_ratio"], size_ratio)
    rows = np.flatnonzero(same)
    return int(rows[0]) if len(rows) else None


def _capsule(shapes: Database, row: int, mean_velocity: float, lab: Lab) -> Capsule:
    """Return the capsule that has the shape in a row of the database at a mean velocity [m/s]."""
    ca, size_ratio = float(shapes["capillary_number"][row]), float(shapes["size_ratio"][row])
    modulus = surface_shear_modulus(viscosity=lab.viscosity, mean_velocity=mean_velocity, capillary_number=ca)
    velocity = mean_velocity * float(shapes["velocity_ratio"][row])
    known = shapes.settings
    channel = cross_section_named(
        known["cross_section"], known.get("corner_radius", 0.0), known.get("section_aspect", 1.0)
    )
    return Capsule(
        capillary_number=ca,
        size_ratio=size_ratio,
        surface_shear_modulus=float(modulus),
        capsule_radius=float(capsule_radius(size_ratio=size_ratio, half_width=lab.half_width)),
        capsule_velocity=velocity,
        velocity_seen=velocity,
        flow_rate=mean_velocity * lab.half_width**2 * channel.area,
        outline=with_extent(shapes["profile"][row], float(shapes["axial_extent"][row])),
        row=row,
    )
