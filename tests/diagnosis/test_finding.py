"""A right model is not accused, whatever the noise is; what a wrong one misses is found, and where."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from sessions import drawn_session

from capsbayes.diagnosis.finding import _by_signs, _Test, find
from capsbayes.diagnosis.scores import REGIONS, region_displacements
from capsbayes.diagnosis.session import Session
from capsbayes.effects import Halo, MotionBlur, catalogue
from capsbayes.measurement import MeasuredOutline
from capsbayes.profile import vertex_normals

CAPSULES = 40


@pytest.mark.parametrize(("outline", "count"), [(False, 150), pytest.param(True, 40, marks=pytest.mark.slow)])
def test_a_right_model_is_not_accused(model, outline, count):
    sessions = (drawn_session(model, CAPSULES, seed=1000 + seed, outline=outline)[0] for seed in range(count))
    claims = sum(find(model, session, seed=1).p_value < 0.05 for session in sessions)
    assert claims <= stats.binom.ppf(0.999, count, 0.05)


@pytest.mark.slow
@pytest.mark.parametrize("stated", [0.8, 1.25])
def test_nor_where_the_noise_is_wrongly_stated(model, stated):
    """The noise is 1 / stated times what the measurements say; larger noise is added, smaller noise is said."""
    accused, count = 0, 20
    for seed in range(count):
        session = drawn_session(model, CAPSULES, seed=2000 + seed, outline=True)[0]
        misstated = [_with_noise(one, stated) for one in session.measurements]
        finding = find(model, Session(misstated, session.experiment), seed=1)
        accused += finding.p_value < 0.05
        assert finding.noise == pytest.approx(1.0 / max(stated, 1.0), rel=0.2)
        assert stated > 1.0 or finding.further_noise == pytest.approx(0.006, rel=0.5)
    assert accused <= stats.binom.ppf(0.999, count, 0.05)


def _with_noise(measurement, factor):
    edge = measurement.outline
    noise = replace(edge.noise, scale=edge.noise.scale * factor)
    return replace(measurement, outline=MeasuredOutline(edge.points, noise, edge.pose))


@pytest.mark.parametrize(("stated", "most"), [(0.002, 1), (0.0, 4)])
def test_an_error_that_a_microscope_gives_all_capsules_is_no_disagreement(model, stated, most):
    """It is no more than the offset that is stated; where none is stated, it cannot be told from physics."""
    accused = 0
    for seed in range(4):
        session = drawn_session(model, CAPSULES, seed=3000 + seed, outline=True, noise=0.003)[0]
        shifted = [_shifted(one, 0.002, stated) for one in session.measurements]
        accused += find(model, Session(shifted, session.experiment), seed=1).p_value < 0.05
    assert accused <= most
    assert stated or accused == most


def _shifted(measurement, size, stated):
    """Move the edge by the same wave around every capsule, of root mean square `size`, and state an offset."""
    edge = measurement.outline
    around = np.arange(len(edge.points)) / len(edge.points)
    wave = np.sqrt(2.0) * size * np.cos(6.0 * np.pi * around)
    points = edge.points + wave[:, None] * vertex_normals(edge.points)
    return replace(measurement, outline=MeasuredOutline(points, edge.noise, replace(edge.pose, offset=stated)))


@pytest.mark.parametrize(
    ("effect", "sizes", "regions"),
    [
        (Halo(), {"halo": 0.3e-6}, ("flanks",)),
        (MotionBlur(), {"exposure": 1.5e-4}, ("nose", "rear on the axis")),
        (catalogue()["pre_inflation"], {"pre_inflation": 0.02}, ("flanks", "rear rim", "rear on the axis")),
        (catalogue()["bending"], {"bending": 2e-3}, ("nose", "rear rim")),
    ],
    ids=lambda one: getattr(one, "name", None),
)
def test_what_a_model_misses_is_found_where_it_is(model, effect, sizes, regions):
    session, _ = drawn_session(model + effect, CAPSULES, seed=7, outline=True, sizes=sizes)
    finding = find(model, session, seed=1)
    assert finding.p_value < 0.01
    assert finding.deviations[0].name in regions
    assert str(finding).startswith(f"{finding.deviations[0].name}: ")


def test_a_halo_is_measured(model):
    """Ca and a/l absorb a part of it, the less the more the flanks say."""
    session, _ = drawn_session(model + Halo(), CAPSULES, seed=8, outline=True, sizes={"halo": 0.5e-6})
    flanks = next(one for one in find(model, session, seed=1).deviations if one.name == "flanks")
    assert 0.1 < flanks.size < 0.5
    assert flanks.unit == "um"
    assert flanks.sigma > 4.0


def test_capsules_without_a_shape_are_a_disagreement(model):
    """Few or none of them are fitted, so that there is little to compare."""
    sizes = {"pre_inflation": 0.1}
    session, _ = drawn_session(model + catalogue()["pre_inflation"], 20, seed=7, outline=True, sizes=sizes)
    found = find(model, session, seed=1)
    assert found.deviations[0].name == "share of capsules without a shape"
    assert found.deviations[0].size > 0.4
    assert found.p_value < 1e-6


def test_regions_are_where_their_names_say(model):
    outline = model.at(capillary_number=0.06, size_ratio=0.9, outline=True).outline[0]
    shapes = dict(zip(REGIONS, region_displacements(outline), strict=True))
    peak = {name: outline[int(np.argmax(np.abs(shape)))] for name, shape in shapes.items()}
    assert peak["nose"][0] == pytest.approx(outline[:, 0].max())
    assert peak["rear rim"][0] == pytest.approx(outline[:, 0].min(), abs=0.02)
    assert abs(peak["rear on the axis"][1]) < 0.03
    assert peak["rear on the axis"][0] < outline[:, 0].mean()
    assert abs(peak["flanks"][1]) > 0.9 * outline[:, 1].max()
    top = outline[:, 1] > 0.1
    assert shapes["top against bottom"][top].min() >= 0.0
    assert shapes["top against bottom"][outline[:, 1] < -0.1].max() <= 0.0


def test_signs_as_they_are_count_among_the_random_ones():
    """Of five contributions alike in sign, one in sixteen patterns of signs has the same sum, up to rounding."""
    contributions = np.array([0.3, 0.1, 0.7, 1.1, 0.9]) / 3.0
    test = _Test("nose", "um", 1.0, contributions, np.ones(5), np.zeros(5))
    assert _by_signs([test], np.random.default_rng(1))[0] == pytest.approx(1.0 / 16.0, abs=0.015)
