import numpy as np
import pytest
from drawn import HALF_WIDTH, circle, drawn

from capsbayes.image.edges.integrals import centroid, centroid_variance
from capsbayes.image.files.picture import Picture
from capsbayes.image.measure import detect
from capsbayes.image.synthetic import Optics, Scene, draw
from capsbayes.profile import Profile


def seen(made):
    return detect(Picture.from_array(made.picture), background=Picture.from_array(made.background))


def test_a_disc_is_a_sphere_seen_from_the_side():
    radius = 0.8 * HALF_WIDTH
    found = seen(draw(Scene(circle(0.8), circle(0.8), half_width=HALF_WIDTH), Optics(), seed=2)).integrals
    truth = {
        "area": np.pi * radius**2,
        "perimeter": 2.0 * np.pi * radius,
        "volume": 4.0 / 3.0 * np.pi * radius**3,
        "stretch_ratio": 1.0,
    }
    for name, value in truth.items():
        one = getattr(found, name)
        assert abs(one.value - value) < 2.5 * one.error, name
        assert one.error < 0.006 * value, name


def test_of_a_capsule_it_is_the_silhouette():
    made = drawn(0.05, 0.8)
    found = seen(made).integrals
    outline = Profile.from_outline(HALF_WIDTH * np.asarray(made.scene.silhouette))
    assert found.area.value == pytest.approx(outline.area, abs=2.5 * found.area.error)
    assert found.perimeter.value == pytest.approx(outline.perimeter, abs=2.5 * found.perimeter.error)


def test_the_centroid_scatters_as_it_says():
    scenes = [draw(Scene(circle(0.8), circle(0.8), 30.0, (90, 90)), Optics(electrons=2000), seed=s) for s in range(20)]
    along = np.array([1.0, 0.0])
    outlines = [seen(made).outline for made in scenes]
    places = [centroid(outline.points)[0] for outline in outlines]
    expected = np.sqrt(np.mean([centroid_variance(outline, along) for outline in outlines]))
    assert np.mean(places) == pytest.approx(44.5, abs=0.02)
    assert 0.4 * expected < np.std(places) < 1.4 * expected
