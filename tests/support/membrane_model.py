"""A manufactured model with four further coordinates, on top of the surrogate of a neo-Hookean membrane.

Each coordinate does something simple to shapes that are smooth: pre-inflation makes the capsule stiffer, the area
dilation modulus and the strain hardening change the lengths, the bending modulus does nothing unless asked to.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from capsbayes.model import CoordinateRange, Domain, ForwardModel
from capsbayes.surrogate import Surrogate

STIFFER = 4.0  # by a pre-inflation of one
SHORTER, SHALLOWER = 0.05, 0.06  # L_z by a K that is e times as large, L_a by a strain hardening of one
RANGES = {
    "pre_inflation": CoordinateRange(0.0, 0.1, 0.0),
    "area_dilation_modulus": CoordinateRange(1.0, 5.0, 3.0, logarithmic=True),
    "strain_hardening": CoordinateRange(0.0, 1.0, 0.0),
    "bending": CoordinateRange(1e-5, 1e-3, 2e-4, logarithmic=True),
}


@dataclass(frozen=True)
class MembraneDomain(Domain):
    """That of the surrogate, by the capillary number of the softer capsule: no box, its border moves."""

    of_surrogate: Domain
    held: tuple = ()

    @property
    def bounds(self):
        (low, high), sizes = self.of_surrogate.bounds
        return (low, high * (1.0 + STIFFER * RANGES["pre_inflation"].high)), sizes

    def contains(self, capillary_number, size_ratio, *coordinates):
        others = [name for name in RANGES if name not in dict(self.held)]
        values = dict(self.held) | (dict(zip(others, coordinates, strict=True)) if coordinates else {})
        inflation = np.asarray(values.get("pre_inflation", 0.0))
        within = self.of_surrogate.contains(np.atleast_1d(capillary_number / (1.0 + STIFFER * inflation)), size_ratio)
        for name, value in values.items():
            within = within & (np.asarray(value) >= RANGES[name].low) & (np.asarray(value) <= RANGES[name].high)
        return within

    def at(self, values):
        return replace(self, held=(*self.held, *values.items()))


class MembraneModel(ForwardModel):
    """See the text of the file; the domain of its fixed form holds all coordinates or none."""

    name = "manufactured membrane"
    sha256 = "1" * 64
    cross_section = "square"
    coordinates = RANGES

    def __init__(self, shorter=SHORTER, shallower=SHALLOWER, blunter=0.0):
        self.surrogate = Surrogate.open("square-neo-hookean")
        self.domain = MembraneDomain(self.surrogate.domain)
        self.shorter, self.shallower, self.blunter = shorter, shallower, blunter

    def __call__(self, theta, *, outline=False):
        self.check_names(theta)
        count = len(theta["capillary_number"])
        known = {name: np.asarray(theta.get(name, np.full(count, ends.null_value))) for name, ends in RANGES.items()}
        inside = self.domain.contains(theta["capillary_number"], theta["size_ratio"], *known.values())
        softer = np.asarray(theta["capillary_number"]) / (1.0 + STIFFER * known["pre_inflation"])
        plain = self.surrogate(
            {"capillary_number": np.where(inside, softer, np.nan), "size_ratio": np.asarray(theta["size_ratio"])},
            outline=outline,
        )
        shorter = self.shorter * np.log(known["area_dilation_modulus"] / RANGES["area_dilation_modulus"].null_value)
        bending = np.where(inside, known["bending"], RANGES["bending"].null_value)
        shorter = shorter + self.blunter * np.log(bending / RANGES["bending"].null_value)
        shallower = self.shallower * known["strain_hardening"]
        made = replace(plain, axial_extent=plain.axial_extent - shorter, axial_length=plain.axial_length + shallower)
        if outline:
            z = plain.outline[..., 0]
            front = np.where(z > z.mean(axis=1, keepdims=True), 1.0, 0.0)
            factor = 1.0 - (shorter / plain.axial_extent)[:, None] * front - 0.1 * shallower[:, None] * (1.0 - front)
            made = replace(made, outline=np.stack([factor * z, plain.outline[..., 1]], axis=-1))
        return made
