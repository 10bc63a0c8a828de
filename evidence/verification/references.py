"""Reference numbers of verification that are not computed here, with their sources.

Lengths are over l (R in a tube, a in shear), velocities over U, pressures over mu U/l.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from evidence.verification.topic import Reference


@dataclass(frozen=True)
class Published:
    """A table of numbers from one source.

    >>> UNDISTURBED.at("circular", "pressure_gradient")
    Reference(value=8.0, source='closed form; series, White, Viscous Fluid Flow, 3-48')
    """

    source: str
    names: tuple[str, ...]
    numbers: Mapping[Any, tuple[float, ...]]

    def at(self, case: Any, name: str) -> Reference:
        """Return one number."""
        return Reference(self.numbers[case][self.names.index(name)], self.source)


CLOSED_FORM = "closed form"

UNDISTURBED = Published(
    "closed form; series, White, Viscous Fluid Flow, 3-48",
    ("centre_velocity", "pressure_gradient"),
    {"square": (2.0962560, 7.113538), "circular": (2.0, 8.0)},
)

FRICTION = Published(
    "Shah & London 1978, table 42",
    ("friction_factor",),  # Fanning's, times the Reynolds number of the hydraulic diameter
    {1.0: (14.227,), 2.0: (15.548,), 0.5: (15.548,)},
)

RIGID_SPHERE = Published(
    "two independent methods, last digit believed",
    ("velocity_ratio", "extra_pressure_drop"),
    {
        ("square", 0.3): (1.990163, 0.024220),
        ("square", 0.5): (1.808701, 0.320879),
        ("square", 0.7): (1.563738, 1.94190),
        ("square", 0.8): (1.42899, 4.3363),
        ("square", 0.85): (1.36050, 6.5400),
        ("square", 0.9): (1.2916, 10.198),
        ("circular", 0.3): (1.880918, 0.039033),
        ("circular", 0.5): (1.679847, 0.521839),
        ("circular", 0.7): (1.416279, 3.28577),
        ("circular", 0.8): (1.27549, 7.7354),
        ("circular", 0.85): (1.2052, 12.234),
        ("circular", 0.9): (1.1357, 20.64),
    },
)

_LENGTHS = ("axial_extent", "axial_length", "velocity_ratio")

PAPER = Published(
    "Quesada et al., identified from an experiment",
    _LENGTHS,
    {(0.082, 0.96): (2.14, 1.81, 1.29)},
)

BOUNDARY_INTEGRAL = Published(
    "another boundary-integral solution",
    _LENGTHS,
    {8: (2.139, 1.819, 1.300), 16: (2.1475, 1.8173, 1.2988)},  # by refinement, at bending 2e-4
)

TUBE = Published(
    "axisymmetric solver without bending, errors below 1e-5",
    _LENGTHS,
    {  # Ca, a/R, pre-inflation
        (0.05, 0.8, 0.0): (1.5345, 1.3668, 1.28055),
        (0.05, 0.9, 0.0): (1.8957, 1.7196, 1.21894),
        (0.05, 1.0, 0.0): (2.3615, 2.1776, 1.18802),
        (0.1, 0.7, 0.0): (1.3339, 1.1398, 1.39495),
        (0.01, 0.8, 0.02): (1.5988, 1.5988, 1.27729),
        (0.01, 1.0, 0.05): (2.1619, 2.1619, 1.09649),
    },
)

SHEAR = (
    Published(
        "Ramanujan & Pozrikidis 1998; the first, Huet & Wachs 2023",
        ("deformation",),
        {0.0375: (0.080,), 0.15: (0.261,), 0.3: (0.384,), 0.6: (0.500,)},
    ),
    Published(
        "Doddi & Bagchi 2008",
        ("deformation",),
        {0.0375: (0.083,), 0.15: (0.279,), 0.3: (0.392,), 0.6: (0.496,)},
    ),
)

SHEAR_SLOPE = Reference(25 / 12, "Barthes-Biesel & Rallison 1981")

MODULI = Published(
    CLOSED_FORM,
    ("area_dilation_modulus",),
    {"neo-hookean": (3.0,)}
    | {f"skalak:hardening={c:g}": (1.0 + 2.0 * c,) for c in (0.0, 0.1, 1.0, 10.0)}
    | {f"hooke:poisson_ratio={nu:g}": ((1.0 + nu) / (1.0 - nu),) for nu in (-0.5, 0.0, 0.5, 0.8)},
)
