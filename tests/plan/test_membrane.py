"""Plans for an unknown membrane, compared with dense normal distributions, limits, and capsules that are identified."""

import json

import numpy as np
import pytest

from capsbayes.errors import InputError
from capsbayes.experiment import Experiment, imposed_velocity
from capsbayes.infer import Membrane, identify
from capsbayes.infer.conditional import MODULUS
from capsbayes.infer.prior import Prior
from capsbayes.infer.shared_membrane import unknowns_of
from capsbayes.measurement import OutlineNoise
from capsbayes.plan import LabErrors, membrane_flow_design, membrane_map
from capsbayes.plan.lab import Expectation
from capsbayes.plan.membrane import PlannedBatch, expected_scores
from capsbayes.status import Status
from capsbayes.surrogate import MembraneSurrogate

LAB = Experiment(cross_section="square", half_width="25 +/- 0.1 um", viscosity="0.85 +/- 0.02 Pa s")
ERRORS = LabErrors(axial_extent=0.01, axial_length=0.01, capsule_velocity=0.01, flow_rate=0.01)
LENGTHS = LabErrors(axial_extent=0.01, axial_length=0.01, capsule_velocity=0.01)
INFLATED = Membrane("neo-Hookean", bending=1e-4)
"""Of which the inflation is unknown alone."""

EXPECTED = "50 +/- 5 mN/m", "23 +/- 1 um"
SPEEDS = 1.5e-3, 4e-3


@pytest.fixture(scope="module")
def square():
    return MembraneSurrogate.open("square")


def designed(square, errors=ERRORS, **options):
    stated = {"seed": 1, "model": square, "membrane": INFLATED, "capsules": 6, "velocities": SPEEDS}
    return membrane_flow_design(*EXPECTED, LAB, errors, **stated | options)


@pytest.fixture(scope="module")
def design(square):
    return designed(square)


@pytest.fixture(scope="module")
def batch(square):
    """The same capsules, of which some may be taken."""
    unknowns = unknowns_of(square, INFLATED, Prior(), LAB, (None, None))
    expectation = Expectation.of(*EXPECTED, LAB)
    return PlannedBatch.of(expectation, np.array(SPEEDS), ERRORS, LAB, square, unknowns, np.zeros(1))


def test_the_curvature_is_that_of_a_dense_normal_distribution(batch):
    """All unknowns together, with differences of the model to first order: no Schur complement, no arrow."""
    expected = batch.expected_from((0, 1), 6)
    seen, own = expected.capsules.batch, expected.values.own[0]
    n = len(seen)
    spreads = expected.unknowns.spreads

    def shapes(point):
        model = expected.capsules.model
        inflation = (expected.unknowns.membranes(np.array([[score]])) for score in (centre[-1], point[-1]))
        places = (values[: 2 * n].reshape(1, n, 2) for values in (centre, point))
        begin, end = map(model.theta, inflation, places)
        here, changes = model.with_slopes(begin, [end])
        return here.numbers + changes.numbers[0], here.log_ratio + changes.log_ratio[0]

    def away(point):
        """Whitened differences from measurements and priors; columns: own, mean ln G_s, mean a/l, pump, score."""
        (numbers, log_ratio), (mean, size, pump, score) = shapes(point), point[2 * n :]
        log_ca, sizes = point[: 2 * n].reshape(n, 2).T
        rows = (seen.target - np.einsum("nqk,nk->nq", seen.rows, numbers)).ravel()
        moduli = expected.capsules.log_viscosity + seen.log_mean_velocity + pump * seen.rate_error - log_ca
        velocity = seen.log_velocity - seen.log_mean_velocity - log_ratio - pump * seen.rate_error
        parts = [rows, (moduli - mean) / spreads[0], velocity / seen.velocity_error]
        return np.concatenate([*parts, (sizes - size) / spreads[1], [pump, score]])

    centre = np.concatenate([own.ravel(), [np.log(0.05), 0.92, 0.0, 0.0]])
    steps = np.concatenate([np.tile([2e-3, 1e-3], n), np.full(3, 1e-3), [0.02]])
    slopes = np.array(
        [(away(centre + step * row) - away(centre)) / step for step, row in zip(steps, np.eye(len(steps)), strict=True)]
    )
    dense = np.linalg.inv(slopes @ slopes.T)
    assert expected.covariance[MODULUS, MODULUS] == pytest.approx(dense[2 * n, 2 * n], rel=0.02)
    assert expected.covariance[-1, -1] == pytest.approx(dense[-1, -1], rel=0.02)


def test_capsules_and_flow_rates_tell_more_the_more_they_are(batch):
    few, many = batch.expected_from((1,), 3), batch.expected_from((1,), 12)
    assert many.log_modulus_variance < 0.9 * few.log_modulus_variance
    assert batch.expected_from((0, 1), 12).log_volume("pre_inflation") < many.log_volume("pre_inflation")
    assert not many.seeks("strain_hardening")


def test_the_errors_that_all_share_are_not_averaged_away(batch):
    variances = [batch.expected_from((1,), count).log_modulus_variance for count in (400, 4000)]
    assert variances[1] > ERRORS.flow_rate**2
    assert variances[1] > 0.2 * variances[0]  # a tenth, were all errors those of single capsules


def test_widths_hold_the_errors_of_viscosity_and_half_width(design):
    (planned,) = design.sets
    sds = planned.sds
    assert planned.mean_velocities == pytest.approx(SPEEDS)
    assert sds["surface_shear_modulus"] > planned.sd_if_known > 0.02 / 0.85
    assert sds["capsule_radius"] > 0.1 / 25
    assert 0.0 < sds["pre_inflation"] < design.prior_sds["pre_inflation"]
    assert design.prior_sds["pre_inflation"] == pytest.approx(0.1 / np.sqrt(12.0), rel=0.01)
    assert design.for_law is None
    assert design.status is Status.DONE
    assert json.loads(json.dumps(design.as_dict()))["membrane"]["area_dilation_modulus"] == 3.0
    of_mean, of_each = sds["surface_shear_modulus"], sds["surface_shear_modulus_each"]
    assert 0.8 * of_mean < of_each < np.hypot(of_mean, 0.15)  # spread and model error of one capsule


def test_an_error_of_the_pixel_size_is_shared_by_all_and_outlines_tell_more_than_lengths(square, design):
    sds = design.sets[0].sds
    assert designed(square, scale_error=0.05).sets[0].sds["capsule_radius"] > 1.1 * sds["capsule_radius"]
    outlines = LabErrors(0.01, 0.01, 0.01, outline=OutlineNoise(0.005, 0.4), flow_rate=0.01)
    assert designed(square, outlines).sets[0].sds["pre_inflation"] < 0.7 * sds["pre_inflation"]


def test_velocities_out_of_the_model_are_told_apart(design):
    risks = design.table()
    assert np.all(np.diff(risks["below"]) <= 0.0)
    assert np.all(np.diff(risks["beyond"]) >= 0.0)
    assert np.all(risks["beyond_margin"] >= risks["beyond"])
    low, high = design.limits
    refused = risks[(risks["mean_velocity"] < low) | (risks["mean_velocity"] > high)]
    assert (refused[["below", "beyond_margin"]].max(axis=1) > design.risk).all()
    lost = risks["below"] + risks["beyond"] + design.outside
    assert np.all(risks["without_shape"] >= lost - 0.02)


def test_the_best_of_few_flow_rates_is_sought(square):
    found = designed(square, velocities=(), capsules=4, flows=1, same_capsule=True)
    (planned,) = found.sets
    assert found.limits[0] <= planned.mean_velocities[0] <= found.limits[1]
    assert found.capsules == 1


def test_one_capsule_counts_once_at_each_flow_rate(square):
    few, many = (designed(square, same_capsule=True, capsules=count) for count in (1, 40))
    assert few.sets == many.sets


def test_a_guess_is_where_the_membrane_is_expected(square):
    unknowns = unknowns_of(square, Membrane("Skalak"), Prior(), LAB, (None, None))
    scores = expected_scores(unknowns, Membrane(area_dilation_modulus=3.0, pre_inflation=0.0), square)
    there = unknowns.membranes(scores[None])
    assert there["area_dilation_modulus"][0] == pytest.approx(3.0)
    assert 0.0 < there["pre_inflation"][0] < 0.002  # just within the prior
    ends = square.coordinates["bending"]
    assert there["bending"][0] == pytest.approx(np.sqrt(ends.low * ends.high))
    with pytest.raises(InputError, match="guess: strain_hardening: expected a number for one of pre_inflation"):
        expected_scores(unknowns, Membrane(strain_hardening=0.5), square)
    with pytest.raises(InputError, match="guess: pre_inflation: expected a number"):
        expected_scores(unknowns, Membrane(pre_inflation="0.03 +/- 0.01"), square)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"flows": 9}, "flows, capsules: expected 1 to 5 flow rates and at least one capsule, got 9, 40"),
        ({"margin": 2.0}, "margin, risk: expected shares"),
        ({"velocities": [1.0]}, "velocities: expected velocities at which square-membrane has a shape"),
    ],
)
def test_bad_arguments_are_refused(square, options, message):
    with pytest.raises(InputError, match=message):
        designed(square, **{"velocities": (), "capsules": 40} | options)


def test_a_size_that_the_model_has_not_and_lengths_in_metres_are_refused(square):
    with pytest.raises(InputError, match=r"a radius between 0\.75 and 1\.1 l"):
        membrane_flow_design("50 mN/m", "35 um", LAB, ERRORS, seed=1, model=square)
    metres = LabErrors(0.5e-6, 0.01, 0.5e-6, over_half_width=False)
    with pytest.raises(InputError, match="those of lengths over l"):
        membrane_flow_design("50 mN/m", "23 um", LAB, metres, seed=1, model=square)


# The map of one capsule with the membrane unknown is that of the engine that identifies it, wider than a known one

SHEET = Membrane("Blatz-Ko", bending=1e-4)
GUESS = {"pre_inflation": 0.03, "area_dilation_modulus": 3.0}


@pytest.fixture(scope="module")
def found(square):
    return membrane_map(LAB, LENGTHS, model=square, membrane=SHEET, guess=Membrane(**GUESS), grid=(3, 2))


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
    seen = LENGTHS.measured(there.values[0, :2], float(speed * there.velocity_ratio[0]))
    posterior = identify(seen, square, LAB, engine="quadrature", seed=1, membrane=SHEET)
    assert float(found["unknown_lengths"][row, column]) == pytest.approx(posterior.log_modulus_sd, rel=0.05)


def test_what_is_no_plane_is_refused(square):
    with pytest.raises(InputError, match="grid: expected two points along each axis"):
        membrane_map(LAB, LENGTHS, model=square, grid=(1, 5))
    metres = LabErrors(0.5e-6, 0.01, 0.5e-6, over_half_width=False)
    with pytest.raises(InputError, match="membrane_map: errors: expected those of lengths over l"):
        membrane_map(LAB, metres, model=square)
