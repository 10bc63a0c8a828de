"""The sessions of the exam: pools of simulated shapes, laboratories drawn at random, and cells with a fault each."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import xarray as xr

from capsbayes.database import Database, content_hash
from capsbayes.diagnosis.blind import (
    TRUE_EFFECTS,
    Lab,
    Noise,
    TrueEffect,
    different_settings,
    simulator_with,
    true_effect_of,
)
from capsbayes.effects import catalogue
from capsbayes.errors import InputError
from capsbayes.model import Effect
from capsbayes.physics.build import Cases, build_database
from evidence.exam.foreign import FOREIGN, LAWS, PATTERN, SmoothNoise

# Pools of shapes: one database for each effect and size

_CAPILLARY_NUMBERS = (0.0315, 0.0365, 0.042, 0.0475, 0.0545, 0.0625, 0.0725, 0.0845, 0.0965, 0.107)
_SIZE_RATIOS = (0.79, 0.818, 0.862, 0.89, 0.933, 0.963)
_DIGITS = 4

_SIZES: dict[str, tuple[float, ...]] = {
    "none": (0.0,),
    "pre_inflation": (0.008, 0.015, 0.035),
    "bending": (6e-4, 2e-3),
    "rest_aspect": (0.925, 1.03, 1.075),
    "corner_radius": (0.07, 0.16),
    "section_aspect": (0.925, 1.03, 1.075),
    "strain_hardening": (0.3, 0.8),
    "unsteadiness": (0.7, 1.5),
    "hooke_share": (1.0,),
    **dict.fromkeys(LAWS, (1.0,)),
}

_PLAIN_BLOCKS = 10

_EFFECTS = {**TRUE_EFFECTS, PATTERN.name: PATTERN, **{name: effect for name, (effect, _) in FOREIGN.items()}}
POOLS = MappingProxyType({(effect, size): _EFFECTS[effect] for effect, sizes in _SIZES.items() for size in sizes})
"""True effect of each pool, by its name and size."""


def blocks_of(effect: str, size: float, half: str) -> range:
    """Return the numbers of the files of a pool; no place of a half is one of the other."""
    return range(_FIRST_BLOCK[half], _FIRST_BLOCK[half] + (1 if size else _PLAIN_BLOCKS))


def pool_name(effect: str, size: float, block: int = 0) -> str:
    """Return the name of one of a pool's files without its ending."""
    words = re.sub("[^a-z0-9]+", "-", effect.lower())
    return f"{words}-{size:g}" + (f"-block-{block}" if block else "")


def pool_cases(block: int = 0) -> Cases:
    """Return Ca and a/l of the shapes of each file of a pool."""
    # Those of the first are all between the nodes of the shipped databases. Those of a further one are drawn at random,
    # one in each cell of the lattice of the first.
    if block == 0:
        return [(ca, size) for size in _SIZE_RATIOS for ca in _CAPILLARY_NUMBERS]
    rng = np.random.default_rng([block, len(_SIZE_RATIOS)])
    sizes = _between(_SIZE_RATIOS, rng, _DIGITS)
    return [(ca, size) for size in sizes for ca in _between(_CAPILLARY_NUMBERS, rng, _DIGITS + 2)]


def _between(places: tuple[float, ...], rng: np.random.Generator, digits: int) -> list[float]:
    """Draw as many places, in equal parts of the range of some."""
    parts = np.arange(len(places)) + rng.random(len(places))
    low, high = places[0], places[-1]
    return [round(float(low * (high / low) ** (part / len(places))), digits) for part in parts]


def read_pool(folder: Path, effect: str, size: float, half: str) -> Database:
    """Return all shapes of a half's pool in a folder, as far as its files are there."""
    paths = [folder / f"{pool_name(effect, size, block)}.nc" for block in blocks_of(effect, size, half)]
    parts = [Database.read(path) for path in paths if path.exists() or path == paths[0]]
    if len(parts) == 1:
        return parts[0]
    whole = xr.concat(
        [part.dataset.isel(border=slice(0)) for part in parts],
        "case",
        data_vars="minimal",
        coords="minimal",
        compat="override",
        combine_attrs="override",
    )
    return Database(whole.assign_attrs(sha256=content_hash(whole)))


def build_pools(
    names: Iterable[tuple[str, float]], folder: Path, half: str, *, workers: int | None = None, further: bool = False
) -> None:
    """Build those of some pools of a half, named by keys of `POOLS`, that a folder lacks."""
    # The further files of a pool are built only if they are asked for; pools of other settings or cases are refused.
    for effect, size in names:
        simulator = simulator_with(POOLS[effect, size], size)
        for block in blocks_of(effect, size, half)[: None if further else 1]:
            path, cases = folder / f"{pool_name(effect, size, block)}.nc", pool_cases(block)
            if not path.exists():
                build_database(simulator, cases, out=path, workers=workers, compact=True)
            part = Database.read(path)
            missing = {*cases} - {*zip(part["capillary_number"].tolist(), part["size_ratio"].tolist(), strict=True)}
            if different := different_settings(part, simulator) + ["cases"] * bool(missing):
                got = f"one made with other {', '.join(different)}"
                raise InputError(str(path), "", "the pool of shapes of this name", got, "remove it to build it anew")


# Laboratories: each session has one of its own, drawn at random

_HALF_WIDTHS, _HALF_WIDTH_ERRORS = (15e-6, 30e-6), (0.004, 0.015)
_VISCOSITIES, _VISCOSITY_ERRORS = (0.3, 1.5), (0.01, 0.04)
_VELOCITIES, _FLOW_RATES, _REACH = (2.5e-3, 6e-3), (3, 6), (1.6, 2.2)
_FLOW_RATE_ERRORS, _STATED = (0.005, 0.02), 0.5  # and the share of the labs that state flow rates
_SPREADS, _CAPSULES = (0.08, 0.2), (24, 48)
_MIDDLE = 0.058  # Ca of the median capsule at the middle flow rate, in the middle of the simulated ones
_SCALES, _LENGTHS, _POINTS = (0.006, 0.015), (0.1, 0.3), (32, 64)
_MISSTATED = (0.5, 2.0)  # true over stated amplitude, and likewise of the correlation length
_TAILS = (None, None, 5.0)  # degrees of freedom of the errors of whole capsules, as likely each


def in_words() -> str:
    """Say between which ends the laboratories are drawn."""
    microns, percent = ([scale * end for end in ends] for scale, ends in ((1e6, _HALF_WIDTHS), (100.0, _SPREADS)))
    return (
        f"half widths of {microns[0]:g} to {microns[1]:g} um, {_FLOW_RATES[0]} to {_FLOW_RATES[1] - 1} flow rates, "
        f"{_CAPSULES[0]} to {_CAPSULES[1] - 1} capsules, G_s that scatters by {percent[0]:.0f} to {percent[1]:.0f} %, "
        f"and stated errors of the edges of {_SCALES[0]:g} to {_SCALES[1]:g} l"
    )


def drawn_lab(rng: np.random.Generator, *, flow_rates: bool | None = None) -> tuple[Lab, int]:
    """Draw a laboratory and the number of its capsules; half of the labs state flow rates, or all, or none."""
    # The kernel of the errors along the outline, their amplitude and their correlation length are not those that the
    # lab states, and of a third of the labs they have heavy tails.
    half_width, viscosity, middle = (_log_uniform(rng, ends) for ends in (_HALF_WIDTHS, _VISCOSITIES, _VELOCITIES))
    reach = rng.uniform(*_REACH)
    velocities = np.geomspace(middle / np.sqrt(reach), middle * np.sqrt(reach), int(rng.integers(*_FLOW_RATES)))
    stated = bool(rng.random() < _STATED) if flow_rates is None else flow_rates
    flow_rate_error = float(rng.uniform(*_FLOW_RATE_ERRORS))
    viscosity_error = float(rng.uniform(*_VISCOSITY_ERRORS))
    lab = Lab(
        half_width=half_width,
        half_width_error=half_width * float(rng.uniform(*_HALF_WIDTH_ERRORS)),
        viscosity=viscosity,
        viscosity_error=viscosity * viscosity_error,
        viscosity_stated=float(rng.normal(1.0, viscosity_error)),
        mean_velocities=tuple(float(velocity) for velocity in velocities),
        surface_shear_modulus=viscosity * middle / _MIDDLE,
        spread=float(rng.uniform(*_SPREADS)),
        noise=drawn_noise(rng),
        flow_rate_error=flow_rate_error if stated else None,
    )
    return lab, int(rng.integers(*_CAPSULES))


def drawn_noise(rng: np.random.Generator) -> Noise:
    """Draw errors of measurement that differ from what is stated of them."""
    noise = Noise(
        scale=float(rng.uniform(*_SCALES)),
        correlation_length=float(rng.uniform(*_LENGTHS)),
        velocity=float(rng.uniform(*_FLOW_RATE_ERRORS)),
        understated=_log_uniform(rng, _MISSTATED),
        freedom=_TAILS[int(rng.integers(len(_TAILS)))],
        points=int(rng.integers(*_POINTS)),
        longer=_log_uniform(rng, _MISSTATED),
    )
    return SmoothNoise(**vars(noise)) if rng.integers(2) else noise


def _log_uniform(rng: np.random.Generator, ends: tuple[float, float]) -> float:
    return float(np.exp(rng.uniform(*np.log(ends))))


# Cells

HALVES = {"locked": 6, "development": 4}
"""Halves of the exam in the order of their page, and which range of seeds each has; no range is used twice."""

_FIRST_BLOCK = {"locked": 20, "development": 0}

_SESSIONS, _NULL_SESSIONS, _OUTSIDE_SESSIONS = 6, 207, 13  # some 213 of each third
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
    counted: bool = True  # in shares of all sessions; a smooth random pattern is what the diagnosis itself assumes
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
        combined = true_effect_of(self.own[self.effect]) if self.effect in self.own else _EFFECTS[self.effect]
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
    simulated = [pair for pair in POOLS if pair[0] not in ("none", *LAWS)]
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
        Cell(f"{_shown(*pair)}, not in the catalogue", *pair, False, _OUTSIDE_SESSIONS, removed=pair[:1])
        for pair in _TAKEN_OUT
    ]
    cells += [Cell(name, name, size, False, _OUTSIDE_SESSIONS) for name, (_, size) in FOREIGN.items()]
    cells += [Cell(f"pattern {size:g}", "pattern", size, False, counted=False) for size in (0.01, 0.02)]
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
