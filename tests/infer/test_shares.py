import numpy as np
import pytest

from capsbayes.experiment import Experiment
from capsbayes.infer.identify import REST, variance_shares
from capsbayes.infer.quadrature import Quadrature
from capsbayes.quantity import Quantity


def shares_of(model, experiment, seen):
    quadrature = Quadrature(model, experiment)
    return variance_shares(quadrature, seen, quadrature(seen), "surface_shear_modulus")["surface_shear_modulus"]


def test_shares_add_up_and_are_those_of_error_propagation(model, experiment, capsule):
    shares = shares_of(model, experiment, capsule)
    assert sum(shares.values()) == pytest.approx(1.0)
    assert abs(shares[REST]) < 0.02
    step, at = 1e-4, np.array([np.log(0.082), 0.96])

    def values(point):
        return model({"capillary_number": np.exp(point[:1]), "size_ratio": point[1:]}).values[0]

    slopes = np.stack([(values(at + e) - values(at - e)) / (2.0 * step) for e in step * np.eye(2)], axis=1)
    modulus = -np.array([1.0, 0.0]) - slopes[2] / 1.29  # log G_s by (log Ca, a/l)
    by_length = modulus @ np.linalg.inv(slopes[:2])
    parts = {
        "axial_extent": (by_length[0] * 0.01) ** 2,
        "axial_length": (by_length[1] * 0.01) ** 2,
        "viscosity": (0.02 / 0.85) ** 2,
        "capsule_velocity": 0.01**2,
    }
    total = parts["viscosity"] / shares["viscosity"]
    for name, part in parts.items():
        assert shares[name] == pytest.approx(part / total, rel=0.05), name
    covariance = model({"capillary_number": np.array([0.082]), "size_ratio": np.array([0.96])}).covariance[0]
    gain = np.append(by_length, -1.0 / 1.29)
    assert shares["surrogate"] == pytest.approx(gain @ covariance @ gain / total, rel=0.15)


def test_the_half_width_has_a_share_only_where_the_lengths_are_in_metres(model, capsule, capsule_in_metres):
    loose = Experiment(cross_section="square", half_width=Quantity(25e-6, 1e-6), viscosity=0.85)
    assert shares_of(model, loose, capsule)["half_width"] == 0.0
    assert shares_of(model, loose, capsule_in_metres)["half_width"] > 0.01


def test_what_is_not_seen_is_owed_to_the_prior(model, experiment, capsule_from_the_side):
    shares = shares_of(model, experiment, capsule_from_the_side)
    assert shares[REST] > 0.9
    assert "axial_length" not in shares
