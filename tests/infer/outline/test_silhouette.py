"""Silhouettes with L_a, and models of the other view."""

from dataclasses import replace

import numpy as np
import pytest

from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.infer import identify
from capsbayes.infer.outline import OutlineLikelihood, SilhouetteLength
from capsbayes.infer.quadrature import Quadrature
from capsbayes.measurement import SILHOUETTE, MeasuredOutline, Measurement, OutlineNoise
from capsbayes.profile import vertex_normals
from capsbayes.surrogate import Surrogate

NOISE = OutlineNoise(0.004, 0.3, 0.5)
EXPERIMENT = Experiment(cross_section="square", half_width=50e-6, viscosity=0.7)
FLOW = 4e-3
ANGLE = np.linspace(0.0, 2.0 * np.pi, 64, endpoint=False)
CIRCLE = np.stack([np.cos(ANGLE), np.sin(ANGLE)], axis=1)


@pytest.fixture(scope="module")
def model():
    return Surrogate.open("square-neo-hookean", view="silhouette")


@pytest.fixture(scope="module")
def capsule(model):
    """A parachute at Ca = 0.08, a/l = 0.95 from the side, with errors, its rear seen through the rim."""
    there = model.at(capillary_number=0.08, size_ratio=0.95, outline=True)
    vertices = there.outline[0][::3]
    errors = NOISE.drawn(np.random.default_rng(4), vertices, 1)[0]
    velocity = FLOW * float(there.velocity_ratio[0])
    return Measurement(
        axial_extent=float(np.ptp(vertices[:, 0])),
        axial_extent_error=0.004,
        axial_length=float(there.axial_length[0]) + 0.002,
        axial_length_error=0.004,
        capsule_velocity=velocity,
        capsule_velocity_error=0.002 * velocity,
        outline=MeasuredOutline(vertices + errors[:, None] * vertex_normals(vertices), NOISE, view=SILHOUETTE),
    )


def test_whitened_displacements_reach_the_length():
    """A measured outline that lies farther out at the nose has a longer L_a, one that does at the rear has not."""
    seen = OutlineLikelihood(0.9 * CIRCLE, NOISE, 0.9 * CIRCLE, length=SilhouetteLength(1.5, 0.02))
    nose, rear = (np.exp(-4.0 * (1.0 - side * CIRCLE[:, 0]) ** 2)[None] for side in (1.0, -1.0))
    assert seen.whitened_displacement(nose).shape == (1, 65)
    plain = replace(seen, noise=OutlineNoise(0.01, 0.0, 1.0))
    assert plain.whitened_displacement(nose)[0, -1] > 1.0
    assert abs(plain.whitened_displacement(rear)[0, -1]) < 1e-3


def test_the_length_narrows_what_the_silhouette_says(model, capsule):
    engine = Quadrature(model, EXPERIMENT)
    without = replace(capsule, axial_length=None, axial_length_error=None)
    both, alone = engine(capsule), engine(without)
    for name, truth in (("capillary_number", 0.08), ("size_ratio", 0.95)):
        assert abs(both.marginal(name).mean - truth) < 3.5 * both.marginal(name).sd
        assert abs(alone.marginal(name).mean - truth) < 3.5 * alone.marginal(name).sd
    # the shape of the rest tells the depth of the rear to 0.01 l or so: a measured one narrows that a little further
    assert both.log_marginal("capillary_number").sd < alone.log_marginal("capillary_number").sd


def test_a_silhouette_and_a_further_coordinate_need_no_grid_for_each_cell(capsule):
    model = Surrogate.open("square-pre-inflation", view="silhouette")
    found = identify(capsule, model, EXPERIMENT, seed=1)
    assert (found.engine, found.status.name) == ("quadrature", "DONE")
    assert {"effective draws", "Pareto k of the weights"} <= {gate.name for gate in found.gates}
    for name, truth in (("capillary_number", 0.08), ("size_ratio", 0.95)):
        assert abs(found.marginals[name].mean - truth) < 3.5 * found.marginals[name].sd
    # which the silhouette tells: the capsule is not inflated
    assert found.marginals["pre_inflation"].upper_95 < 0.05


def test_a_model_of_the_other_view_is_refused(capsule, model):
    mid_plane = Surrogate.open("square-neo-hookean")
    message = r'outline\.view: expected "mid-plane", that of the outlines of square-neo-hookean, got "silhouette"'
    with pytest.raises(InputError, match=message):
        identify(capsule, mid_plane, EXPERIMENT, seed=1, engine="quadrature")
    seen = replace(capsule, outline=replace(capsule.outline, view="mid-plane"))
    with pytest.raises(InputError, match=r'expected "silhouette", .* open the model with view="mid-plane"'):
        identify(seen, model, EXPERIMENT, seed=1, engine="quadrature")


def test_a_mid_plane_outline_needs_no_length(capsule):
    assert capsule.length_with_outline == (capsule.axial_length, 0.004)
    assert replace(capsule, outline=replace(capsule.outline, view="mid-plane")).length_with_outline is None
