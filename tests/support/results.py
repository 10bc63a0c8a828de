"""Results for the tests of pages: a posterior and the table of a few capsules, by quadrature on the cheap model."""

import functools

import numpy as np
import xarray as xr
from polynomial_model import PolynomialModel

from capsbayes.experiment import Experiment
from capsbayes.infer import Quadrature, identify
from capsbayes.infer.population import Population
from capsbayes.infer.posterior import REPORTED
from capsbayes.measurement import Measurement
from capsbayes.quantity import Quantity

MODEL = PolynomialModel()
EXPERIMENT = Experiment(cross_section="square", half_width=Quantity(25e-6, 0.2e-6), viscosity=Quantity(0.85, 0.02))
KINDS = ("median", "lower_68", "upper_68", "lower_95", "upper_95", "mean", "sd")


def measured(capillary_number=0.082, size_ratio=0.96, *, error=0.01, **known):
    """What would be measured of such a capsule, without noise, in a flow of 4 mm/s."""
    seen = MODEL({"capillary_number": np.array([capillary_number]), "size_ratio": np.array([size_ratio])})
    return Measurement(
        axial_extent=float(seen.axial_extent[0]),
        axial_extent_error=error,
        axial_length=float(seen.axial_length[0]),
        axial_length_error=error,
        capsule_velocity=4e-3 * float(seen.velocity_ratio[0]),
        capsule_velocity_error=4e-5,
        **known,
    )


@functools.cache
def posterior():
    """Posterior of the paper's capsule."""
    return identify(
        measured(source="folder/capsule.toml", sha256="ab" * 32), MODEL, EXPERIMENT, engine="quadrature", seed=3
    )


@functools.cache
def population():
    """Eight capsules, the second of which was not seen and the fifth of which leans on the border."""
    engine = Quadrature(MODEL, EXPERIMENT)
    errors = (0.01, np.nan, 0.02, 0.005, 0.03, 0.008, 0.015, 0.012)
    found = [
        None if np.isnan(error) else engine(measured(0.06 + 0.004 * k, 0.86 + 0.02 * k, error=error))
        for k, error in enumerate(errors)
    ]
    variables = {
        f"{name}_{kind}": (
            "capsule",
            np.array([np.nan if one is None else getattr(one.marginal(name), kind) for one in found]),
        )
        for name in REPORTED
        for kind in KINDS
    }
    status = ["DONE", "NO_CAPSULE", "DONE", "DONE", "LEANS_ON_BORDER", "DONE", "DONE", "DONE"]
    variables["status"] = ("capsule", np.array(status))
    variables["name"] = ("capsule", np.array([f"capsule {k} <{'ab'[k % 2]}>" for k in range(len(errors))]))
    pedigree = {"version": "0.1.0", "model": MODEL.name, "sha256": MODEL.sha256, "seed": 3, "experiment": "e.toml"}
    return Population.of_dataset(xr.Dataset(variables, attrs=pedigree))


def grown(number):
    """The same capsules over and over."""
    few = population()
    return Population.of_dataset(few.dataset.isel(capsule=np.arange(number) % len(few)))
