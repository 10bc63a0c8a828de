"""The one table of quantities: name, symbol, unit, the display unit, and meaning."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

SI_UNITS = ("", "m", "Pa s", "m/s", "N/m", "m^3/s", "1/s", "s", "s/m", "kg/m^3")
"""Units in which numbers are held at the public doors, with that of a ratio; others are scales of the flow problem."""


@dataclass(frozen=True)
class Parameter:
    """One quantity of the language.

    Parameters
    ----------
    name : str
        Python name, the same in functions, files and results.
    symbol : str
        Symbol of the papers, in plain text.
    latex : str
        The symbol for figures, without dollar signs.
    unit : str
        Unit in which the number is held: SI, or "-" for a ratio, or the scale
        that makes it dimensionless.
    shown_unit : str
        Unit in which it is displayed.
    scale : float
        Factor from `unit` to `shown_unit`.
    meaning : str
        One line.

    Examples
    --------
    >>> PARAMETERS["capsule_radius"].label
    'a [µm]'
    >>> round(PARAMETERS["surface_shear_modulus"].shown(0.04), 6)
    40.0
    """

    name: str
    symbol: str
    latex: str
    unit: str
    shown_unit: str
    scale: float
    meaning: str

    @property
    def si(self) -> str:
        """SI unit, empty for a ratio and for what is over a scale of the flow problem."""
        return self.unit if self.unit in SI_UNITS else ""

    @property
    def label(self) -> str:
        """Symbol with the display unit; a bare symbol for a ratio."""
        return f"{self.symbol} [{self.shown_unit}]" if self.shown_unit not in ("", "-") else self.symbol

    @property
    def axis_label(self) -> str:
        """Label for the axis of a figure."""
        return f"${self.latex}$ [{self.shown_unit}]" if self.shown_unit not in ("", "-") else f"${self.latex}$"

    def shown(self, value: float) -> float:
        """Return a value in the display unit."""
        return value * self.scale


_SHOWN = {  # unit and factor of the display, by the unit of the table; any other is displayed as it is
    "N/m": ("mN/m", 1e3),
    "m": ("µm", 1e6),
    "m/s": ("mm/s", 1e3),
    "m^3/s": ("µL/min", 6e10),
    "s": ("µs", 1e6),
    "s/m": ("% per mm/s", 0.1),
    "Pa": ("MPa", 1e-6),
    "%": ("%", 1e2),
    "°": ("°", 180.0 / math.pi),
}

# name, symbol, the symbol for figures, unit ("%" and "°" for ratios that are displayed so), meaning
_TABLE = (
    # of the capsule
    ("surface_shear_modulus", "G_s", r"G_\mathrm{s}", "N/m", "shear modulus of the membrane"),
    ("surface_dilation_modulus", "K_s", r"K_\mathrm{s}", "N/m", "area dilation modulus of the membrane, K times G_s"),
    (
        "surface_young_modulus",
        "E_s",
        r"E_\mathrm{s}",
        "N/m",
        "Young's modulus of the membrane, 4 K_s G_s/(K_s + G_s)",
    ),
    ("young_modulus", "E", "E", "Pa", "Young's modulus of the membrane's material, E_s / t"),
    ("largest_tension", "T_max", r"T_\mathrm{max}", "N/m", "largest principal tension of the membrane"),
    ("capsule_radius", "a", "a", "m", "radius of the capsule at rest"),
    ("bending", "B", "B", "G_s a^2", "bending modulus of the membrane"),
    ("membrane_thickness", "t", "t", "m", "thickness of the membrane"),
    ("pre_inflation", "alpha", r"\alpha", "-", "radius added by inner pressure before the flow, over that without"),
    ("rest_aspect", "A_0", "A_0", "-", "axis of the shape at rest along the flow over that across"),
    ("hardening", "C", "C", "-", "hardening of a Skalak membrane, the cost of a change of area relative to a shear"),
    ("area_dilation_modulus", "K", "K", "G_s", "resistance of the membrane to a change of area at small strain"),
    ("strain_hardening", "h", "h", "-", "share of Skalak's energy with C = 1 in that of a neo-Hookean membrane"),
    (
        "hooke_share",
        "s_H",
        r"s_\mathrm{H}",
        "-",
        "share of generalised Hooke's energy in that of a neo-Hookean membrane",
    ),
    # of the experiment
    ("half_width", "l", r"\ell", "m", "half width of the channel"),
    ("corner_radius", "r_c/l", r"r_\mathrm{c}/\ell", "-", "radius of the corners of the cross-section"),
    ("section_aspect", "b/l", r"b/\ell", "-", "depth of the channel along the direction of view over the width seen"),
    ("viscosity", "mu", r"\mu", "Pa s", "viscosity of the suspending liquid"),
    ("viscous_tension", "mu U", r"\mu U", "N/m", "viscosity times mean velocity of the flow"),
    ("density", "rho", r"\rho", "kg/m^3", "density of the suspending liquid"),
    ("mean_velocity", "U", "U", "m/s", "mean velocity of the undisturbed flow"),
    ("flow_rate", "Q", "Q", "m^3/s", "volume of the liquid that flows through in a time"),
    ("capsule_velocity", "v_o", r"v_\mathrm{o}", "m/s", "velocity of the capsule"),
    ("frame_rate", "f", "f", "1/s", "pictures per second of a film"),
    ("exposure", "t_e", r"t_\mathrm{e}", "s", "time for which a picture is exposed"),
    # of the flow problem
    ("capillary_number", "Ca", r"\mathrm{Ca}", "-", "capillary number mu U / G_s"),
    ("size_ratio", "a/l", r"a/\ell", "-", "radius at rest over half width"),
    ("velocity_ratio", "v_o/U", r"v_\mathrm{o}/U", "-", "velocity of the capsule over mean undisturbed velocity"),
    ("unsteadiness", "l/(U t)", r"\ell/(Ut)", "U/l", "inverse of the time since the capsule was put into the flow"),
    # of the steady shape
    ("axial_extent", "L_z", r"L_z/\ell", "l", "maximum extension along the flow"),
    ("axial_length", "L_a", r"L_a/\ell", "l", "length on the axis"),
    ("parachute_depth", "L_p", r"L_p/\ell", "l", "depth of the concave rear L_z - L_a"),
    ("perimeter", "P", r"P/\ell", "l", "length of the profile in the plane x = 0"),
    ("stretch_ratio", "Lambda", r"\Lambda", "-", "perimeter over that at rest P / (2 pi a)"),
    ("inner_pressure", "p_in", r"p_\mathrm{in}", "mu U/l", "pressure of the inner liquid"),
    ("extra_pressure_drop", "dP+", r"\Delta P^+", "mu U/l", "pressure drop added by the capsule"),
    ("minimum_tension", "tau_min", r"\tau_\mathrm{min}", "G_s", "smallest principal tension of the membrane"),
    ("maximum_tension", "tau_max", r"\tau_\mathrm{max}", "G_s", "largest principal tension of the membrane"),
    ("wrinkling_rate", "sigma", r"\sigma", "U/l", "growth rate of wrinkles about the axis, where checked"),
    # of the picture, and of what the flow does to the channel
    ("halo", "delta", r"\delta", "m", "distance by which all detected edges lie too far out"),
    ("pixel_scale", "eps_p", r"\epsilon_\mathrm{p}", "%", "relative error of the size of a pixel"),
    ("pixel_aspect", "h_p/w_p", r"h_\mathrm{p}/w_\mathrm{p}", "-", "height of a pixel over its width"),
    (
        "distortion",
        "k_r",
        r"k_\mathrm{r}",
        "%",
        "relative change of the magnification a half width away from the middle of the picture",
    ),
    ("taper", "k_t", r"k_\mathrm{t}", "%", "relative change of the magnification along a half width downstream"),
    ("velocity_scale", "eps_v", r"\epsilon_v", "%", "relative error of the velocities of all capsules"),
    ("flow_rate_error", "eps_Q", r"\epsilon_Q", "%", "relative error of the stated flow rates, of all alike"),
    (
        "half_width_error",
        "eps_l",
        r"\epsilon_\ell",
        "%",
        "relative error of the stated half width, which scales the picture",
    ),
    (
        "half_width_apart",
        "eps_la",
        r"\epsilon_{\ell,\mathrm{a}}",
        "%",
        "relative error of the stated half width, by which lengths in metres are divided",
    ),
    ("rotation", "theta", r"\theta", "°", "angle of the flow in the picture"),
    ("swelling", "s_l", r"s_\ell", "s/m", "relative widening of the channel per velocity"),
    # of the membranes of a session, and of the liquid
    ("modulus_slope", "d ln G_s / d ln a", r"d\ln G_\mathrm{s}/d\ln a", "-", "power of the size with which G_s grows"),
    ("viscosity_error", "eps_mu", r"\epsilon_\mu", "%", "relative error of the viscosity"),
    # of a population
    ("modulus_spread", "sd ln G_s", r"\sigma_{\ln G_\mathrm{s}}", "%", "spread of G_s among capsules"),
    (
        "modulus_spread_at_given_size",
        "sd ln G_s | a",
        r"\sigma_{\ln G_\mathrm{s}|a}",
        "%",
        "spread of G_s among capsules of one size",
    ),
    ("inflation_spread", "sd ln alpha", r"\sigma_{\ln\alpha}", "%", "spread of the pre-inflation among capsules"),
    ("radius_spread", "sd ln a", r"\sigma_{\ln a}", "%", "spread of a among capsules"),
    ("modulus_freedom", "nu of G_s", r"\nu_{G_\mathrm{s}}", "-", "freedom of the t distribution of G_s"),
    ("radius_freedom", "nu of a", r"\nu_a", "-", "freedom of the t distribution of a"),
    # of a simulation
    ("iterations", "k", "k", "-", "Newton iterations"),
    ("refinement", "n", "n", "-", "subdivisions of an edge of the octahedron"),
    ("residual", "R", "R", "U", "largest collocation residual of the steady state"),
    ("slack", "s", "s", "U", "uniform normal velocity left over, an indicator of the mesh's error"),
)


def _parameter(name: str, symbol: str, latex: str, unit: str, meaning: str) -> Parameter:
    held = "-" if unit in ("%", "°") else unit
    return Parameter(name, symbol, latex, held, *_SHOWN.get(unit, (unit, 1.0)), meaning)


PARAMETERS: Mapping[str, Parameter] = MappingProxyType({row[0]: _parameter(*row) for row in _TABLE})
"""Every quantity by name."""


class Plausible(NamedTuple):
    """Example of a stated quantity that can be read, and its plausible range of any experiment, SI."""

    example: str
    least: float  # a number beyond the range was most likely meant in another unit
    most: float


STATED: Mapping[str, Plausible] = MappingProxyType(
    {
        "surface_shear_modulus": Plausible("10 mN/m", 1e-8, 1e3),
        "capsule_radius": Plausible("25 um", 1e-8, 0.1),
        "half_width": Plausible("25.0 +/- 0.2 um", 1e-7, 0.1),
        "viscosity": Plausible("0.85 +/- 0.02 Pa s", 1e-6, 1e3),
        "viscous_tension": Plausible("0.028 +/- 0.001 N/m", 1e-12, 1e3),
        "density": Plausible("998 kg/m^3", 1e2, 3e4),
        "flow_rate": Plausible("0.60 uL/min", 1e-18, 1e-3),
        "capsule_velocity": Plausible("5.00 +/- 0.05 mm/s", 1e-9, 2.0),
        "axial_extent": Plausible("2.14 +/- 0.01", 1e-2, 20.0),
        "axial_length": Plausible("1.81 +/- 0.01", 1e-4, 20.0),
        "frame_rate": Plausible("2000 Hz", 1e-3, 1e9),
        "exposure": Plausible("20 us", 1e-9, 10.0),
        "membrane_thickness": Plausible("0.6 +/- 0.2 um", 1e-10, 1e-2),
    }
)
"""The quantities that a user states, by name."""

BELIEVED = ("surface_shear_modulus", "capsule_radius", "membrane_thickness")
"""Those that are not measured: their errors may be larger than their values."""

OF_THE_MEMBRANE = ("pre_inflation", "area_dilation_modulus", "strain_hardening", "bending")
"""Parameters of a membrane of the general law."""

COORDINATES = (
    "pre_inflation",
    "area_dilation_modulus",
    "bending",
    "hardening",
    "strain_hardening",
    "rest_aspect",
    "corner_radius",
    "section_aspect",
    "unsteadiness",
)
"""Coordinates that a forward model may have in addition to the capillary number and the size ratio."""
