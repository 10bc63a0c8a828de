"""The map of one capsule with the membrane unknown: that of the engine that identifies it, wider than a known one."""

import numpy as np
import pytest

from capsbayes.errors import InputError
from capsbayes.experiment import Experiment, imposed_velocity
from capsbayes.infer import Membrane, identify
from capsbayes.plan import LabErrors, membrane_map
from capsbayes.surrogate import MembraneSurrogate

LAB = Experiment(cross_section="square", half_width="25 +/- 0.1 um", viscosity="0.85 +/- 0.02 Pa s")
ERRORS = LabErrors(axial_extent=0.01, axial_length=0.01, capsule_velocity=0.01)
SHEET = Membrane("Blatz-Ko", bending=1e-4)
GUESS = {"pre_inflation": 0.03, "area_dilation_modulus": 3.0}


@pytest.fixture(scope="module")
def square():
    return MembraneSurrogate.open("square")


@pytest.fixture(scope="module")
def found(square):
    return membrane_map(LAB, ERRORS, model=square, membrane=SHEET, guess=Membrane(**GUESS), grid=(3, 2))


def test_what_is_not_known_of_the_membrane_widens_g_s(found):
    unknown, known = found["unknown_lengths"].to_numpy(), found["known_lengths"].to_numpy()
    inside = np.isfinite(unknown)
    assert inside.any()
    np.testing.assert_array_equal(inside, np.isfinite(known))
    assert np.all(known[inside] > 0.02 / 0.85)
    assert np.median(unknown[inside] / known[inside]) > 1.2
    ca = found["capillary_number"].to_numpy()
    beyond = (ca < found["lowest"].to_numpy()[:, None]) | (ca > found["highest"].to_numpy()[:, None])
    assert not np.any(inside & beyond)
    assert "unknown_outline" not in found


def test_a_point_is_the_width_of_the_capsule_that_is_identified(found, square):
    row, column = (int(places[0]) for places in np.nonzero(np.isfinite(found["unknown_lengths"].to_numpy())))
    ca, size = float(found["capillary_number"][column]), float(found["size_ratio"][row])
    there = square.at(capillary_number=ca, size_ratio=size, strain_hardening=0.0, bending=1e-4, **GUESS)
    speed = imposed_velocity(viscosity=0.85, capillary_number=ca, surface_shear_modulus=0.02)
    seen = ERRORS.measured(there.values[0, :2], float(speed * there.velocity_ratio[0]))
    posterior = identify(seen, square, LAB, engine="quadrature", seed=1, membrane=SHEET)
    assert float(found["unknown_lengths"][row, column]) == pytest.approx(posterior.log_modulus_sd, rel=0.05)


def test_bad_arguments_are_refused(square):
    with pytest.raises(InputError, match="grid: expected two points along each axis"):
        membrane_map(LAB, ERRORS, model=square, grid=(1, 5))
    metres = LabErrors(0.5e-6, 0.01, 0.5e-6, over_half_width=False)
    with pytest.raises(InputError, match="membrane_map: errors: expected those of lengths over l"):
        membrane_map(LAB, metres, model=square)
