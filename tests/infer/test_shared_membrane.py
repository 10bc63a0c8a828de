"""The membrane of a batch: found where it is told, its prior kept where not, and stated as the files say."""

import json
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from linear_shapes import ALONG, Linear, linear_batch
from scipy import stats
from scipy.special import expit, ndtri, softmax

from capsbayes.errors import InputError, NoShapeError
from capsbayes.experiment import Experiment
from capsbayes.infer import Membrane, Prior
from capsbayes.infer.conditional import Capsules
from capsbayes.infer.proposal import Draws, quasi_random
from capsbayes.infer.shared_membrane import (
    FUNCTIONS,
    MISFIT,
    Found,
    LawOdds,
    MembraneSampling,
    Sampled,
    averaged,
    identify_membrane,
    log_density_variance,
    with_odds,
)
from capsbayes.infer.verdict import RANGE
from capsbayes.measurement import Measurement
from capsbayes.prediction import Prediction
from capsbayes.report.membrane import caveats, law_table, law_words, membrane_table
from capsbayes.surrogate import MembraneSurrogate

EXPERIMENT = Experiment(cross_section="square", half_width="25 +/- 0.1 um", viscosity="0.85 +/- 0.02 Pa s")
TRUTH = {"pre_inflation": 0.03, "area_dilation_modulus": 3.0, "strain_hardening": 0.0, "bending": 1e-4}
MODULUS = 0.05
NEO_HOOKEAN = Membrane("neo-Hookean", bending=1e-4)


@pytest.fixture(scope="module")
def capsules():
    """Eight capsules of the model at two flow rates, lengths to 0.005 l, neo-Hookean."""
    model, rng = MembraneSurrogate.open("square"), np.random.default_rng(4)
    found, moduli = [], []
    for number in range(8):
        modulus = MODULUS * np.exp(0.1 * rng.normal())
        speed = (0.04, 0.08)[number % 2] * MODULUS / 0.85
        theta = {"capillary_number": 0.85 * speed / modulus, "size_ratio": 0.9 + 0.04 * rng.normal(), **TRUTH}
        seen = model.at(**theta)
        extent, length = seen.axial_extent[0] + 0.005 * rng.normal(), seen.axial_length[0] + 0.005 * rng.normal()
        velocity = float(speed * seen.velocity_ratio[0])
        errors = {"axial_extent_error": 0.005, "axial_length_error": 0.005, "capsule_velocity_error": 0.01 * velocity}
        found.append(
            Measurement(extent, axial_length=length, capsule_velocity=velocity, **errors, source=f"no {number}")
        )
        moduli.append(modulus)
    return found, np.array(moduli)


def identified(measurements, membrane=NEO_HOOKEAN, **options):
    return identify_membrane(measurements, EXPERIMENT, seed=1, membrane=membrane, **{"laws": False} | options)


@pytest.fixture(scope="module")
def known(capsules):
    """With a membrane of which inflation is unknown alone."""
    return identified(capsules[0])


def test_an_inflation_is_found(known):
    assert list(known.prior) == ["pre_inflation"]
    assert known.marginals["pre_inflation"].contains(0.03, level=95)
    assert known.widths_over_prior()["pre_inflation"] < 0.5
    assert known.marginals["surface_shear_modulus"].contains(MODULUS, level=95)


def test_flow_rates_take_the_place_of_velocities(known, capsules):
    still = []
    for number, capsule in enumerate(capsules[0]):
        rate = (0.04, 0.08)[number % 2] * MODULUS / 0.85 * 4.0 * 25e-6**2
        of_pump = {"flow_rate": rate, "flow_rate_error": 0.01 * rate}
        still.append(replace(capsule, capsule_velocity=None, capsule_velocity_error=np.nan, **of_pump))
    found = identified(still)
    assert found.flow.tolist() == known.flow.tolist()
    for name, truth in (("pre_inflation", 0.03), ("surface_shear_modulus", MODULUS)):
        assert found.marginals[name].contains(truth, level=95)
        assert found.marginals[name].sd == pytest.approx(known.marginals[name].sd, rel=0.4)


def test_each_capsule_has_its_own_modulus_and_radius(known, capsules):
    each = zip(known.of_each("surface_shear_modulus"), capsules[1], strict=True)
    held = [one.contains(modulus, level=95) for one, modulus in each]
    assert np.mean(held) > 0.7
    assert all(abs(one.median / 22.5e-6 - 1.0) < 0.15 for one in known.of_each("capsule_radius"))
    for ending in ("", "_each"):
        ratio = known.draws[f"surface_dilation_modulus{ending}"] / known.draws[f"surface_shear_modulus{ending}"]
        np.testing.assert_allclose(ratio, 3.0)
    both = known.moduli_by_flow()
    assert both[0].median == pytest.approx(both[1].median, rel=0.2)


def test_the_file_holds_draws_and_summary(known, tmp_path):
    with xr.open_dataset(known.write(tmp_path / "membrane.nc")) as stored:
        assert dict(stored.sizes) == {"draw": 1000, "capsule": 8}
        summary = json.loads(stored.attrs["summary"])
        middle = np.median(stored["pre_inflation"])
    assert summary["quantities"]["pre_inflation"]["median"] == pytest.approx(middle)
    assert [capsule["name"] for capsule in summary["capsules"]] == list(known.names)
    assert all("surface_dilation_modulus" in of_one for of_one in (summary["quantities"], *summary["capsules"]))
    assert "K_s [mN/m]" in membrane_table(known).to_string()
    assert summary["status"] == known.status.name


@pytest.mark.parametrize(
    ("p_value", "status", "said"), [(0.06, "DONE", 0), (0.009, "DONE", 1), (0.004, "SHAPES_MISFIT", 1)]
)
def test_a_misfit_is_said_before_it_is_refused(capsules, monkeypatch, p_value, status, said):
    def misfit(found, *place):
        square = stats.chi2.isf(p_value, found.batch.known.sum()) - found.batch.left.sum()
        return np.full((1000, 8), square / 8)

    monkeypatch.setattr(Capsules, "misfit", misfit)
    found = identified(capsules[0], Membrane("neo-Hookean", bending=1e-4, pre_inflation=0.03))
    sentences = [sentence for sentence in caveats(found) if MISFIT in sentence]
    assert found.status.name == status
    assert len(sentences) == said
    assert all(f"{p_value:g}" in sentence for sentence in sentences)
    gate = next(gate for gate in found.as_dict()["gates"] if gate["name"] == MISFIT)
    assert gate.get("caveat") == (sentences[0] if p_value == 0.009 else None)


def test_a_parameter_at_an_end_of_its_range_is_said(capsules):
    """Of membranes whose inflation is known and wrong, K makes up for it as far as its range reaches."""
    found = identified(capsules[0], Membrane(strain_hardening=0.0, bending=1e-4, pre_inflation=0.1))
    dilation = found.draws["area_dilation_modulus"]
    for name, k in (("", dilation), ("_each", dilation[:, None])):
        moduli = k * found.draws[f"surface_shear_modulus{name}"]
        np.testing.assert_allclose(found.draws[f"surface_dilation_modulus{name}"], moduli)
    [(border, share)] = found.leaning.items()
    assert border == f"{RANGE}area_dilation_modulus"
    assert share == found.as_dict()["share_next_to_border"][border] > 0.2
    assert any("next to the end of the range of the model in K." in sentence for sentence in caveats(found))


def test_nothing_changes_with_the_order_of_capsules_but_rounding(known, capsules):
    turned = identified(capsules[0][::-1])
    here, there = known.marginals["pre_inflation"], turned.marginals["pre_inflation"]
    assert there.median == pytest.approx(here.median, abs=0.1 * here.sd)


def test_a_wrong_law_is_improbable_where_lengths_are_exact(capsules):
    """Of a membrane known but for its law, h = 0 or 1."""
    membrane = Membrane(pre_inflation=0.03, bending=1e-4, area_dilation_modulus=3.0)
    found = identified(capsules[0], membrane, laws=True)
    assert [law.name for law in found.laws] == ["none of them", "Blatz-Ko", "Skalak"]
    assert sum(law.probability for law in found.laws) == pytest.approx(1.0)
    assert found.laws[1].probability > found.laws[2].probability  # with K = 3 the first is neo-Hookean


def test_the_range_of_the_probability_of_a_law_is_that_over_the_errors_of_the_model():
    odds = 3.5 + 3.0 * stats.norm.ppf((np.arange(FUNCTIONS) + 0.5) / FUNCTIONS)
    logs = {"general": np.zeros(FUNCTIONS), "Skalak": odds}
    laws = with_odds([(name, Sampled(None, None, log, 0.1, ()), {}) for name, log in logs.items()])
    assert laws[1].probability == pytest.approx(np.mean(expit(odds)))
    assert laws[1].over_errors == pytest.approx(expit(3.5 + 3.0 * stats.norm.ppf([0.05, 0.95])), abs=0.01)
    assert laws[0].over_errors == pytest.approx(1.0 - np.array(laws[1].over_errors[::-1]))


@pytest.mark.parametrize(
    ("probability", "over_errors", "words"),
    [
        (0.99, (0.96, 1.0), "The membrane obeys the Skalak law: 99 to 1 against"),
        (0.97, (0.8, 1.0), "The membrane rather obeys the Skalak law, 32 to 1 against"),
        (0.97, (0.4, 1.0), "The model's own error could decide between Skalak (40.0 to 100.0 %) and none of them"),
        (0.8, (0.79, 0.81), "The membrane rather obeys the Skalak law, 4 to 1 against"),
        (0.6, (0.59, 0.61), "The capsules do not tell the law: the Skalak law against a general law stands"),
    ],
)
def test_a_law_is_named_only_if_no_error_of_the_model_could_decide_it(known, probability, over_errors, words):
    general = LawOdds(
        "none of them", 1.0 - probability, (1.0 - over_errors[1], 1.0 - over_errors[0]), 0.1, True, known.draws
    )
    skalak = LawOdds("Skalak", probability, over_errors, 0.1, True, known.draws)
    found = replace(known, laws=(general, skalak))
    assert law_words(found).startswith(words)
    assert f"{100.0 * over_errors[0]:.1f} to {100.0 * over_errors[1]:.1f} %" in law_table(found).to_string()
    assert law_table(found)["probability"].iloc[0].endswith("%")  # of a law that is possible
    assert ("ruled out" in law_table(found).to_string()) is (over_errors[0] > 0.95)
    unknown = law_table(replace(found, laws=(replace(general, usable=False), skalak)))
    assert list(unknown["probability"])[1] == "not known"
    assert found.as_dict()["laws"][1]["probability_over_model_errors"] == list(over_errors)


def test_pictures_of_one_capsule_have_one_modulus(capsules):
    known = Membrane("neo-Hookean", bending=1e-4, pre_inflation=0.03)
    found = identified([capsules[0][0]] * 3, known, same_capsule=True)
    moduli = found.draws["surface_shear_modulus_each"]
    assert np.ptp(moduli, axis=1).max() < 0.03 * moduli.mean()
    assert not found.prior


def test_inflations_that_differ_are_found_of_each_capsule(capsules):
    """Of capsules with the same inflation, the spread is told to be small and the median is what it was."""
    found = identified(capsules[0], inflation_varies=True)
    assert found.marginals["pre_inflation"].contains(0.03, level=95)
    assert 0.0 < found.marginals["inflation_spread"].median < 0.5
    each = found.draws["pre_inflation_each"]
    assert each.shape == (1000, 8)
    scatter = np.log(each / found.draws["pre_inflation"][:, None]).std(axis=1)
    assert np.corrcoef(np.log(scatter), np.log(found.draws["inflation_spread"]))[0, 1] > 0.5
    assert "pre_inflation" in found.as_dict()["capsules"][0]


class Narrow(MembraneSampling):
    """A normal posterior in six dimensions, so narrow that no draw over the prior lies in it."""

    dimensions = 6
    SCALES = np.geomspace(1e-6, 1e-4, 6)
    CENTRE = np.linspace(-1.0, 1.0, 6)

    def _first(self):
        points = ndtri(quasi_random(6, 256, 1))
        return self.weighted(points, stats.norm.logpdf(points).sum(axis=1))

    def weighted(self, points, log_drawn, near=None):
        log, zero = stats.norm.logpdf(points, self.CENTRE, self.SCALES).sum(axis=1), np.zeros(len(points))
        nothing = np.zeros((len(points), 1))
        found = Found(log, log, zero, nothing, zero + 1.0, nothing[:, None], nothing)
        return Draws(points, log, log_drawn, found)


def test_a_narrow_posterior_is_sought_until_its_draws_are_alive():
    sampled = Narrow(None, None)()
    assert all(gate.passed for gate in sampled.gates)
    weights = softmax(sampled.log_weights)
    mean = weights @ sampled.draws.points
    spread = np.sqrt(weights @ (sampled.draws.points - mean) ** 2)
    assert np.allclose(mean, Narrow.CENTRE, atol=0.2 * Narrow.SCALES)
    assert np.allclose(spread, Narrow.SCALES, rtol=0.1)
    assert np.allclose(sampled.log_evidence, 0.0, atol=0.1)


@pytest.mark.slow
def test_worker_processes_find_the_same(known, capsules):
    found = identified(capsules[0], workers=2)
    for name, values in known.draws.items():
        np.testing.assert_allclose(found.draws[name], values, rtol=1e-9)


def test_measurements_must_be_there_and_alike(capsules):
    with pytest.raises(InputError, match="at least one"):
        identify_membrane([], EXPERIMENT, seed=1)
    metres = Measurement(axial_extent="50.0 +/- 0.3 um", capsule_velocity="5.00 +/- 0.05 mm/s")
    with pytest.raises(InputError, match="lengths over l"):
        identify_membrane([metres], EXPERIMENT, seed=1)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"prior": Prior(surface_shear_modulus="20 .. 80 mN/m")}, "surface_shear_modulus: expected none"),
        ({"membrane": Membrane(membrane_thickness="5 um")}, "membrane_thickness: expected a thickness from"),
        ({"membrane": Membrane(pre_inflation=0.5)}, "pre_inflation: expected 0 to 0.1"),
        ({"membrane": Membrane(pre_inflation=0.0), "inflation_varies": True}, "a pre-inflation that is not 0"),
        ({"same_capsule": True, "inflation_varies": True}, "inflation_varies: expected several capsules"),
    ],
)
def test_what_a_batch_cannot_use_is_refused(capsules, options, message):
    with pytest.raises(InputError, match=message):
        identify_membrane(capsules[0], EXPERIMENT, seed=1, laws=False, **options)


def test_a_model_without_any_shape_is_refused(capsules, monkeypatch):
    monkeypatch.setattr(MembraneSurrogate, "__call__", _without_shapes)
    with pytest.raises(NoShapeError, match="a membrane that gives all capsules a steady shape"):
        identify_membrane(capsules[0], EXPERIMENT, seed=1, laws=False)


def _without_shapes(model, theta, *, outline=False):
    """Predict nothing anywhere."""
    count = len(theta["capillary_number"])
    nothing = np.full(count, np.nan)
    return Prediction(*[nothing] * 4, np.full((count, 3, 3), np.nan), np.zeros(count, dtype=bool))


@pytest.fixture
def batch():
    return linear_batch()


LOGS = np.array([0.0, -3.0, -1.0, -np.inf])
PLACES = np.array([[0.0], [1.0], [30.0], [0.5]])


def test_weights_of_an_exact_model_stay():
    found = averaged(LOGS, PLACES, np.zeros(4))
    np.testing.assert_allclose(softmax(found.log_weights), softmax(LOGS), atol=1e-12)
    np.testing.assert_allclose(found.log_evidence, np.log(np.mean(np.exp(LOGS))), rtol=1e-12)


def test_draws_of_one_membrane_have_one_error():
    found = averaged(LOGS, np.tile(PLACES[:1], (4, 1)), np.array([1.0, 9.0, 4.0, 2.0]))
    np.testing.assert_allclose(softmax(found.log_weights), softmax(LOGS), atol=1e-12)
    assert found.log_evidence.std() > 1.0


@pytest.mark.parametrize("away", [0.5, 1.0, 20.0])
def test_the_odds_of_two_membranes_are_averaged_over_the_difference_of_their_errors(away):
    """It is normal with the variance 2 V (1 - exp(-r^2 / 2))."""
    variance, log_odds = 16.0, 4.0
    places = np.array([[0.0, 0.0], [0.6 * away, 0.8 * away]])
    found = averaged(np.array([log_odds, 0.0]), places, np.full(2, variance))
    spread = np.sqrt(2.0 * variance * (1.0 - np.exp(-0.5 * away**2)))
    nodes = stats.norm.ppf((np.arange(2000) + 0.5) / 2000)
    wanted = np.mean(expit(log_odds + spread * nodes))
    assert softmax(found.log_weights)[0] == pytest.approx(wanted, abs=2.0 / np.sqrt(FUNCTIONS))
    assert wanted < expit(log_odds)


def test_the_variance_is_that_of_the_misfit_by_errors_that_no_shape_absorbs(batch):
    """Drawn errors of the numbers, less what the best Ca and a/l of each capsule make of them."""
    error, rng = 0.01, np.random.default_rng(3)
    capsules = Capsules(batch, Linear(error=error), 0.0)
    own = np.tile([np.log(0.05), 0.9], (1, len(batch), 1))
    found = log_density_variance(capsules, {"pre_inflation": np.array([0.05])}, own)
    squares = []
    for rows in batch.rows:
        wrong = rows @ (error * rng.standard_normal((3, 4000)))
        absorbed = rows @ ALONG
        squares.append(
            np.mean(np.sum((wrong - absorbed @ np.linalg.lstsq(absorbed, wrong, rcond=None)[0]) ** 2, axis=0))
        )
    assert found[0] == pytest.approx(np.sum(squares), rel=0.05)


def found_with(misfit, variance):
    """Capsules at membranes of which only the misfit, chi^2, and the stated variance matter."""
    some = np.zeros((len(misfit), 1))
    return Found(some[:, 0], -0.5 * np.asarray(misfit), np.asarray(variance), some, some[:, 0], some[:, None], some)


@pytest.mark.parametrize("size", [5.0, 30.0])
def test_the_misfit_bounds_what_the_error_of_the_model_may_be(size):
    """At the true membrane, where the model errs by less than is stated; the best one has an error of 1."""
    rng = np.random.default_rng(2)
    bounds = []
    for _ in range(2000):
        noise, error, of_best = rng.standard_normal((3, 200))
        error *= size / np.linalg.norm(error)
        misfit = [np.sum((noise + of_best / np.linalg.norm(of_best)) ** 2), np.sum((noise + error) ** 2)]
        bounds.append(found_with(misfit, [1.0, 1e4]).likely_variance[1])
    assert np.mean(np.sqrt(bounds) >= size) > 0.95
    assert np.median(bounds) < (size + 5.0) ** 2


def test_a_smaller_error_stays_as_it_is_stated():
    found = found_with([200.0, 204.0, 300.0], [9.0, 12.0, 80.0])
    np.testing.assert_array_equal(found.likely_variance, found.variance)


def test_shapes_that_absorb_every_error_leave_no_variance(batch):
    """As where one length is measured of each capsule."""
    one = replace(batch, rows=batch.rows[:, :1], target=batch.target[:, :1], scale=batch.scale[:, :1])
    own = np.tile([np.log(0.05), 0.9], (1, len(batch), 1))
    found = log_density_variance(Capsules(one, Linear(error=0.1), 0.0), {"pre_inflation": np.array([0.05])}, own)
    assert found[0] == pytest.approx(0.0, abs=1e-6)
