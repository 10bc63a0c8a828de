"""The membrane of the capsule drawn for the README is found."""

import tomllib
from pathlib import Path

import pytest

from capsbayes import Experiment, MembraneSurrogate, identify, measure
from capsbayes.measurement import SILHOUETTE

PICTURES = Path(__file__).parents[2] / "examples" / "pictures"


@pytest.mark.slow
def test_the_moduli_of_the_drawn_capsule_are_in_the_intervals():
    experiment = Experiment.read(PICTURES / "experiment.toml")
    background, velocity = PICTURES / "empty.png", "4.86 +/- 0.04 mm/s"
    seen = measure(PICTURES / "capsule.png", experiment, capsule_velocity=velocity, background=background)
    found = identify(seen, MembraneSurrogate.open("square", view=SILHOUETTE), experiment, seed=1, error_budget=False)
    assert found.status.ok
    truth = tomllib.loads((PICTURES / "truth.toml").read_text())
    modulus = 1e-3 * float(truth["surface_shear_modulus"].removesuffix(" mN/m"))
    for name, true in (("surface_shear_modulus", modulus), ("area_dilation_modulus", 3.0), ("capsule_radius", 23.5e-6)):
        marginal = found.marginals[name]
        assert marginal.contains(true, level=95), (name, marginal)
