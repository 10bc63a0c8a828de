"""What all outlines of a microscope share, and the errors of one of many."""

import numpy as np
import pytest

from capsbayes.errors import InputError
from capsbayes.measurement import MeasuredOutline, OutlineNoise, Pose
from capsbayes.profile import vertex_normals

ANGLE = np.linspace(0.0, 2.0 * np.pi, 60, endpoint=False)
POINTS = np.stack([1.1 * np.cos(ANGLE), 0.8 * np.sin(ANGLE)], axis=1)
NORMAL = vertex_normals(POINTS)


def covariance(outline):
    """Covariance of the normal distances: noise and microscope, place and tilt left out."""
    posed = outline.pose.directions(POINTS, NORMAL)[:, 3:]
    return outline.noise.covariance(POINTS) + posed @ posed.T


@pytest.mark.parametrize("correlation", [0.0, 0.3])
def test_what_capsules_share_counts_as_often_as_there_are_capsules(correlation):
    pose = Pose(offset=0.002, pixel_aspect=0.01, rear=0.004)
    outline = MeasuredOutline(POINTS, OutlineNoise(0.003, correlation, 0.5 if correlation else 0.0), pose)
    shared = outline.shared(POINTS, NORMAL)
    wider = outline.shared_by(9)
    arcs = shared[2:]  # after the offset and the aspect of the pixels
    both = covariance(outline) + 8.0 * shared.T @ shared
    assert covariance(wider) == pytest.approx(both, abs=1e-10)
    assert len(arcs) == (len(POINTS) if correlation else 0)
    assert wider.pose.rear == pytest.approx(3.0 * 0.004)
    assert np.array_equal(wider.points, outline.points)


def test_one_capsule_keeps_its_errors():
    outline = MeasuredOutline(POINTS, OutlineNoise(0.003, 0.3, 0.5), Pose(offset=0.002))
    assert outline.shared_by(1).noise == outline.noise
    assert outline.shared_by(1).pose == outline.pose


@pytest.mark.parametrize("numbers", [(np.inf, 0.2, 0.0), (0.01, np.inf, 0.0), (0.01, 1e300, 0.0), (0.01, 0.2, np.nan)])
def test_an_error_beyond_all_lengths_of_a_capsule_is_refused(numbers):
    with pytest.raises(InputError, match=r"OutlineNoise: .*: expected a (positive )?number up to 1"):
        OutlineNoise(*numbers)
