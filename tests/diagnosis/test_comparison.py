"""Residuals of drawn capsules: where they were put, as large as they were made; a study as numbers."""

import json
from dataclasses import replace

import numpy as np
import pytest
from sessions import drawn_session

from capsbayes.diagnosis import Comparison, diagnose, summary
from capsbayes.diagnosis.fits import fitted
from capsbayes.diagnosis.scores import whitening
from capsbayes.diagnosis.session import Session
from capsbayes.effects import Halo, PixelScale
from capsbayes.measurement import MeasuredOutline

OPTICAL = {one.parameter.name: one for one in (Halo(), PixelScale())}


@pytest.fixture(scope="module")
def compared(model):
    """Eight capsules almost without noise."""
    session, _ = drawn_session(model, 8, seed=1, outline=True, noise=1e-4, settings=True)
    return Comparison(session, model, fitted(model, session, whitening(model, session)))


def test_a_right_model_leaves_the_noise(compared):
    assert compared.gap == pytest.approx(25e-6 * 1e-4, rel=0.5)
    along = compared.along_outline
    assert along.outline.shape == (*along.displacement.shape, 2)
    assert np.abs(along.displacement / along.error).max() < 10.0


def test_medians_are_of_the_capsules_of_each_flow_rate(compared):
    """Flow rates that a sensor has measured, no two alike, are no settings."""
    found = compared.modulus_at_flow_rates
    assert sum(count for count, _ in found.values()) == 8
    for rate, (count, median) in found.items():
        at = [one.flow_rate == rate for one in compared.session.measurements]
        assert (sum(at), np.median(compared.modulus[at])) == (count, median)
    each = [replace(one, flow_rate=1e-9 * (1.0 + 1e-3 * row)) for row, one in enumerate(compared.session.measurements)]
    measured = replace(compared, session=Session(each, compared.session.experiment))
    assert measured.modulus_at_flow_rates == {}
    unknown = [replace(one, flow_rate=None) for one in each]
    assert replace(compared, session=Session(unknown, compared.session.experiment)).modulus_at_flow_rates == {}


def test_a_bump_is_found_where_it_is(compared):
    """Edges put farther out by 1 um at the nose, compared with the predictions before."""
    width, bump = 25e-6, 1e-6
    moved = []
    for row, one in enumerate(compared.session.measurements):
        points, feet = compared.edges[row]
        nose = np.minimum(feet.place, compared.outlines.shape[1] - feet.place) < 6
        points = points + bump / width * nose[:, None] * feet.normal
        moved.append(replace(one, outline=MeasuredOutline(points, one.outline.noise)))
    along = replace(compared, session=Session(moved, compared.session.experiment)).along_outline
    assert int(np.argmax(along.displacement)) % (len(along.outline) - 6) < 6
    assert along.displacement.max() == pytest.approx(bump, rel=0.3)
    assert np.median(np.abs(along.displacement)) < 0.2 * bump


def test_moduli_are_those_of_the_fits(compared):
    assert 0.03 < compared.median_modulus < 0.08
    np.testing.assert_allclose(np.log(compared.modulus), compared.fits.log_modulus)
    nothing = replace(compared, fits=replace(compared.fits, settled=np.zeros(8, dtype=bool)))
    assert np.isnan(nothing.median_modulus)
    assert nothing.along_outline is None
    assert np.isnan(nothing.gap)


def test_a_study_tells_its_steps_and_is_stored(model):
    session, _ = drawn_session(model + PixelScale(), 24, seed=7, sizes={"pixel_scale": 0.04})
    told = []
    study = diagnose(session, model, seed=3, candidates=OPTICAL, level=1.0, progress=lambda *step: told.append(step))
    assert [step for step, _, _ in told[:3]] == ["the model as it is", "halo", "pixel scale"]
    assert [done for _, done, _ in told] == [min(step, 3) for step in range(len(told))]
    assert {steps for _, _, steps in told} == {4}
    stored = json.loads(json.dumps(summary(study), allow_nan=False))
    assert stored["verdict"] == study.verdict.name
    assert (stored["seed"], stored["level"], stored["capsules"], stored["with_outline"]) == (3, 1.0, 24, 0)
    assert {one["parameter"] for one in stored["candidates"]} == set(OPTICAL)
    assert stored["model"]["sha256"] == model.sha256
    assert stored["finding"]["deviations"][0]["p_value"] == study.finding.p_value
