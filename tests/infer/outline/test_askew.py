"""The odd part of an outline, and what a capsule askew tells all the same."""

import numpy as np
import pytest

from capsbayes import Experiment, Measurement, Surrogate, identify
from capsbayes.footing import on_mirror
from capsbayes.infer import outline as of_outline
from capsbayes.infer.outline import odd_directions, outline_likelihood, rear_direction
from capsbayes.measurement import SILHOUETTE, MeasuredOutline, OutlineNoise, Pose, askew_size
from capsbayes.profile import equally_spaced, vertex_normals
from capsbayes.status import Status

NOISE = OutlineNoise(0.003, 0.2, 0.5)
CA, SIZE = 0.06, 0.85
EXPERIMENT = Experiment(cross_section="square", half_width=50e-6, viscous_tension="0.01 +/- 0.0001 N/m")


@pytest.fixture(scope="module")
def model():
    return Surrogate.open("square-neo-hookean", view=SILHOUETTE)


@pytest.fixture(scope="module")
def shape(model):
    seen = model({"capillary_number": np.array([CA]), "size_ratio": np.array([SIZE])}, outline=True)
    return equally_spaced(seen.outline[0], 120)


def bent(shape, size):
    """An outline with an odd displacement of this root mean square, that of the first two waves along it."""
    normal = vertex_normals(shape)
    odd = odd_directions(shape, np.arange(len(shape), dtype=float), normal)[:, [1, 5]] @ [1.0, -0.5]
    turn = shape[:, 0] * normal[:, 1] - shape[:, 1] * normal[:, 0]
    pose = np.stack([normal[:, 1], turn], axis=1)
    odd -= pose @ np.linalg.lstsq(pose, odd)[0]  # a shift and a turn are no odd part
    odd *= size / np.sqrt(np.mean(odd**2))
    return shape + odd[:, None] * normal, odd


def noisy(points, seed=1):
    return points + NOISE.drawn(np.random.default_rng(seed), points, 1)[0][:, None] * vertex_normals(points)


def laid(points):
    """An outline somewhere else, tilted."""
    return points @ np.array([[np.cos(0.03), np.sin(0.03)], [-np.sin(0.03), np.cos(0.03)]]) + [0.3, -0.1]


def posterior(model, points, **pose):
    outline = MeasuredOutline(points, NOISE, Pose(offset=0.001, **pose), SILHOUETTE)
    extent = float(np.ptp(points[:, 0]))
    measured = Measurement(axial_extent=extent, axial_extent_error=0.01, outline=outline)
    return identify(measured, model, EXPERIMENT, seed=1, engine="quadrature")


def holds(found):
    ca, size = found.marginals["capillary_number"], found.marginals["size_ratio"]
    return ca.lower_95 < CA < ca.upper_95 and size.lower_95 < SIZE < size.upper_95


def test_a_symmetric_outline_has_no_odd_part(shape):
    assert np.nanmax(np.abs(on_mirror(laid(shape))[0])) < 2e-4


def test_the_odd_part_is_found_wherever_the_outline_lies(shape):
    points, odd = bent(shape, 0.01)
    found = on_mirror(laid(points))[0]
    assert np.corrcoef(found, odd)[0, 1] > 0.98
    assert np.sqrt(np.mean(found**2)) == pytest.approx(0.01, rel=0.05)
    assert askew_size(noisy(laid(points)), NOISE) == pytest.approx(0.01, rel=0.15)


@pytest.mark.parametrize(("length", "white"), [(0.0, 1.0), (0.2, 0.5), (0.8, 0.05)])
def test_noise_is_no_odd_part(shape, length, white):
    """However few the errors are that are independent along the outline; one in a thousand may be taken for one."""
    noise = OutlineNoise(0.003, length, white)
    errors = noise.drawn(np.random.default_rng(3), shape, 200)
    normal = vertex_normals(shape)
    assert sum(askew_size(shape + each[:, None] * normal, noise) > 0.0 for each in errors) <= 3


def test_a_flank_that_one_wall_hides_is_no_odd_part(shape):
    hidden = (shape[:, 1] > 0.0) & (np.abs(shape[:, 0] - shape[:, 0].mean()) < 0.4)
    assert hidden.sum() > 10
    left = on_mirror(shape[~hidden])[0]
    assert np.isnan(left).sum() > 5
    assert np.nanmax(np.abs(left)) < 1e-3


def test_odd_directions_turn_around_in_a_mirror(shape):
    place, normal = np.arange(len(shape), dtype=float), vertex_normals(shape)
    mirrored = (-place) % len(shape)
    odd = odd_directions(shape, place, normal)
    np.testing.assert_allclose(odd_directions(shape, mirrored, normal[mirrored.astype(int)]), -odd, atol=1e-2)
    assert 0.5 < np.mean(np.sum(odd**2, axis=1)) < 2.0


def test_the_rear_direction_is_that_of_the_rear(shape):
    back = rear_direction(shape, np.arange(len(shape), dtype=float), vertex_normals(shape))
    front = shape[:, 0] > shape[:, 0].mean()
    assert back[front].max() < 0.1
    assert back[len(shape) // 2] == pytest.approx(1.0, abs=0.02)


def test_a_capsule_askew_is_identified_all_the_same(model, shape, monkeypatch):
    points = noisy(laid(bent(shape, 0.012)[0]))
    found = posterior(model, points)
    assert found.status is Status.DONE
    assert holds(found)
    assert "odd part of the outline" in " ".join(str(gate) for gate in found.gates)
    monkeypatch.setattr(of_outline, "askew_size", lambda points, noise: 0.0)
    assert posterior(model, points).status is Status.OUTLINE_MISFIT


def test_one_that_is_too_far_askew_is_lopsided(model, shape):
    assert posterior(model, noisy(bent(shape, 0.03)[0])).status is Status.LOPSIDED


def test_an_odd_part_that_is_not_smooth_stays_a_misfit(model, shape):
    points = noisy(shape)
    away = np.zeros(len(points))
    away[20:24] = 0.05  # something sticks to a flank
    assert posterior(model, points + away[:, None] * vertex_normals(shape)).status is Status.OUTLINE_MISFIT


def test_a_rear_that_is_seen_further_back_moves_the_answer_less_if_its_edge_is_a_band(model, shape):
    """Its standard deviation is then in the interval, which holds the truth."""
    back = rear_direction(shape, np.arange(len(shape), dtype=float), vertex_normals(shape))
    points = noisy(shape + 0.015 * back[:, None] * vertex_normals(shape))
    sharp, band = posterior(model, points), posterior(model, points, rear=0.015)
    assert not holds(sharp)
    assert holds(band)


def test_an_outline_that_is_even_costs_nothing(model, shape):
    """Its likelihood is that of a pose, the model's error and noise alone."""
    theta = {"capillary_number": CA, "size_ratio": SIZE}
    likelihood = outline_likelihood(model, MeasuredOutline(noisy(shape), NOISE, Pose(), SILHOUETTE), theta)
    feet = of_outline.aligned_with(likelihood.points, likelihood.pilot)[1]
    assert not likelihood._of_rear_and_askew(feet).any()
