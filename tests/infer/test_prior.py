import itertools
import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from density_of_all_inputs import log_jacobian, log_prior
from scipy import stats

from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.infer import Quadrature
from capsbayes.infer.log_grid import LogGrid
from capsbayes.infer.prior import Coordinate, Inputs, Marginal, Prior, coordinate_prior
from capsbayes.measurement import Measurement
from capsbayes.model import CoordinateRange
from capsbayes.quantity import Quantity
from capsbayes.status import Status

WIDTH, VISCOSITY = 25e-6, 0.85


def physical(model, ca, size, velocity):
    """(log G_s, a, log U) of (Ca, a/l, v_o)."""
    ratio = model({"capillary_number": np.array([ca]), "size_ratio": np.array([size])}).velocity_ratio[0]
    flow = velocity / ratio
    return np.array([np.log(VISCOSITY * flow / ca), WIDTH * size, np.log(flow)])


def test_a_prior_may_be_stated_by_its_symbol_once():
    by_symbol = Prior(G_s="50 +/- 10 mN/m", a="20 .. 80 um")
    assert by_symbol == Prior(surface_shear_modulus="50 +/- 10 mN/m", capsule_radius="20 .. 80 um")
    assert replace(by_symbol, capsule_radius="20 .. 30 um").surface_shear_modulus == by_symbol.surface_shear_modulus
    with pytest.raises(InputError, match="surface_shear_modulus: expected one statement of G_s, got two"):
        Prior("50 +/- 10 mN/m", G_s="50 +/- 10 mN/m")


@pytest.mark.parametrize(("ca", "size", "velocity"), [(0.082, 0.96, 5e-3), (0.01, 0.75, 2e-3), (0.1, 1.1, 7e-2)])
def test_the_jacobian_is_that_of_the_map_to_physical_quantities(model, ca, size, velocity):
    def at(point):
        return physical(model, np.exp(point[0]), point[1], point[2])

    point, columns = np.array([np.log(ca), size, velocity]), []
    for k, step in enumerate((1e-5, 1e-5, 1e-5 * velocity)):
        shift = np.eye(3)[k] * step
        columns.append((at(point + shift) - at(point - shift)) / (2.0 * step))
    determinant = np.linalg.det(np.stack(columns, axis=1))
    expected = np.exp(log_jacobian(half_width=WIDTH, capsule_velocity=velocity))
    assert abs(determinant) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("shape", ["uniform", "log-uniform"])
def test_a_range_is_normalised_and_ends_where_it_says(shape):
    one = {"uniform": Quantity.uniform, "log-uniform": Quantity.log_uniform}[shape](0.5, 3.0)
    values = np.linspace(0.5, 3.0, 20_001)
    assert np.trapezoid(one.pdf(values), values) == pytest.approx(1.0, rel=1e-4)
    np.testing.assert_allclose(np.ptp(values ** (1 - one.power) * one.pdf(values)), 0.0, atol=1e-12)
    assert np.all(np.isneginf(one.logpdf([0.49, 3.01])))


def test_draws_from_the_prior_are_distributed_as_its_density_says(model):
    """Push draws of (G_s, a, U) through the model and compare with the density in (log Ca, a/l)."""
    rng = np.random.default_rng(3)
    prior = Prior(Quantity.uniform(0.01, 0.3), Quantity.log_uniform(10e-6, 40e-6))
    count = 400_000
    modulus, radius = rng.uniform(0.01, 0.3, count), np.exp(rng.uniform(np.log(10e-6), np.log(40e-6), count))
    flow = np.exp(rng.uniform(np.log(1e-4), np.log(0.1), count))
    ca, size = VISCOSITY * flow / modulus, radius / WIDTH
    prediction = model({"capillary_number": ca, "size_ratio": size})
    velocity = flow * prediction.velocity_ratio
    box = prediction.inside & (np.abs(velocity / 5e-3 - 1.0) < 0.5)  # U is log-uniform only far from its ends
    weights, edges = [], np.linspace(np.log(0.008), np.log(0.1), 7)
    for low, high in itertools.pairwise(edges):
        for small, large in ((0.72, 0.82), (0.82, 0.92), (0.92, 1.0)):
            cell = box & (np.log(ca) > low) & (np.log(ca) <= high) & (size > small) & (size <= large)
            weights.append((np.count_nonzero(cell), _mass(model, prior, (low, high), (small, large))))
    counts, masses = np.array(weights).T
    expected = masses / masses.sum() * counts.sum()
    assert counts.sum() > 5000
    assert np.sum((counts - expected) ** 2 / expected) < 45.0  # 17 degrees of freedom, 99.97 %


def _mass(model, prior, logs, sizes):
    """Prior mass of a cell of (log Ca, a/l) with v_o within half of 5 mm/s, by midpoints."""
    u, s, v = (
        np.ravel(grid)
        for grid in np.meshgrid(
            *(low + (high - low) * (np.arange(8) + 0.5) / 8 for low, high in (logs, sizes, (2.5e-3, 7.5e-3)))
        )
    )
    one = np.ones_like(u)
    theta = {
        "capillary_number": np.exp(u),
        "size_ratio": s,
        "viscosity": VISCOSITY * one,
        "half_width": WIDTH * one,
        "capsule_velocity": v,
    }
    ratio = model(theta).velocity_ratio
    return np.exp(log_prior(prior, theta, ratio)).sum() * (sizes[1] - sizes[0])


def test_ranges_are_read_from_the_file_of_the_capsule(tmp_path):
    path = tmp_path / "capsule.toml"
    path.write_text(
        "[measurement]\n[prior]\n"
        'surface_shear_modulus = { distribution = "uniform", low = "5 mN/m", high = "0.2 N/m" }\n'
    )
    prior = Prior.read(path)
    assert prior.surface_shear_modulus.shape == "uniform"
    assert prior.surface_shear_modulus.low == pytest.approx(5e-3)
    assert prior.surface_shear_modulus.high == pytest.approx(0.2)
    assert prior.capsule_radius == Prior().capsule_radius
    assert prior.described()["surface_shear_modulus"]["distribution"] == "uniform"


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ('radius = "1 um"', "prior.radius: expected one of surface_shear_modulus, capsule_radius"),
        ('capsule_radius = "1 um"', "prior.capsule_radius: expected a distribution"),
        ('capsule_radius = "24 +/- 0.01 um"', "prior.capsule_radius: expected a standard error of at least 0.1%"),
        ('capsule_radius = { distribution = "normal", low = "1 um", high = "2 um" }', "capsule_radius.distribution"),
        ('capsule_radius = { distribution = "uniform", low = "1 Pa", high = "2 um" }', "prior.capsule_radius.low"),
        ('capsule_radius = { distribution = "uniform", low = "3 um", high = "2 um" }', "expected low < high"),
    ],
)
def test_mistakes_in_a_prior_are_named(tmp_path, line, message):
    path = tmp_path / "capsule.toml"
    path.write_text(f"[prior]\n{line}\n")
    with pytest.raises(InputError) as caught:
        Prior.read(path)
    assert message in str(caught.value)
    assert "capsule.toml" in str(caught.value)


@pytest.mark.parametrize("limits", [(0.0, 1.0), (2.0, 1.0), (1.0, np.inf), (np.nan, 1.0)])
def test_a_range_needs_positive_rising_limits(limits):
    with pytest.raises(InputError, match="low < high"):
        Prior(surface_shear_modulus=Quantity.uniform(*limits))


@pytest.mark.parametrize(
    ("stated", "shape"), [("10 .. 100 mN/m", "uniform"), ("log-uniform 10 .. 100 mN/m", "log-uniform")]
)
def test_ranges_are_given_as_text(tmp_path, stated, shape):
    prior = Prior(surface_shear_modulus=stated, coordinates={"pre_inflation": "0 .. 0.1"})
    found = prior.surface_shear_modulus
    assert (found.shape, found.low, found.high) == (shape, pytest.approx(0.01), pytest.approx(0.1))
    assert prior.coordinates["pre_inflation"] == Quantity.uniform(0.0, 0.1)
    path = tmp_path / "capsule.toml"
    path.write_text(f'[prior]\nsurface_shear_modulus = "{stated}"\n')
    assert Prior.read(path).surface_shear_modulus == found


STATED = {
    "normal": "50 +/- 10 mN/m",
    "log-normal": "log-normal 50 +/- 10 mN/m",
    "uniform": "20 .. 80 mN/m",
    "log-uniform": "log-uniform 20 .. 80 mN/m",
    "frozen": stats.gamma(25.0, scale=2e-3),
}


@pytest.mark.parametrize("stated", STATED.values(), ids=STATED)
def test_any_prior_of_the_modulus_weighs_the_posterior_without_it(model, experiment, capsule, stated):
    """Second route: draws under a flat prior of log G_s, weighted by the density of log G_s."""
    loose = replace(capsule, axial_extent_error=0.03, axial_length_error=0.03)
    draws = Quadrature(model, experiment)(loose).drawn(np.random.default_rng(1), 200_000)
    prior = Prior(surface_shear_modulus=stated)
    posterior = Quadrature(model, experiment, prior)(loose)
    weights = prior.surface_shear_modulus.pdf(draws["surface_shear_modulus"]) * draws["surface_shear_modulus"]
    for name in ("surface_shear_modulus", "capsule_radius", "mean_velocity", "capillary_number"):
        logs = np.log(draws[name])
        mean = np.average(logs, weights=weights)
        sd = np.sqrt(np.average((logs - mean) ** 2, weights=weights))
        marginal = posterior.log_marginal(name)
        assert (marginal.mean, marginal.sd) == pytest.approx((mean, sd), abs=0.03 * sd), name


def test_a_prior_of_the_radius_weighs_the_posterior_without_it(model, experiment, capsule):
    draws = Quadrature(model, experiment)(capsule).drawn(np.random.default_rng(1), 200_000)
    posterior = Quadrature(model, experiment, Prior(capsule_radius="24.2 +/- 0.2 um"))(capsule)
    radii = draws["capsule_radius"]
    weights = stats.norm.pdf(radii, 24.2e-6, 0.2e-6)
    mean = np.average(radii, weights=weights)
    sd = np.sqrt(np.average((radii - mean) ** 2, weights=weights))
    marginal = posterior.marginal("capsule_radius")
    assert (marginal.mean, marginal.sd) == pytest.approx((mean, sd), abs=0.03 * sd)


@pytest.mark.parametrize("stated", STATED.values(), ids=STATED)
def test_a_prior_is_read_back_from_its_record(stated):
    prior = Prior(surface_shear_modulus=stated)
    again = Prior.of_record(json.loads(json.dumps(prior.described())), {})
    values = np.array([0.02, 0.05, 0.07])
    np.testing.assert_allclose(
        again.surface_shear_modulus.logpdf(values), prior.surface_shear_modulus.logpdf(values), rtol=1e-12
    )


@pytest.mark.parametrize(
    ("prior", "words"),
    [
        (Prior(surface_shear_modulus="1 .. 2 mN/m"), "2 mN/m as the upper end of its prior"),
        (Prior(surface_shear_modulus="1 .. 2 N/m"), "1000 mN/m as the lower end of its prior"),
        (Prior(capsule_radius="1 .. 2 um"), "2 µm as the upper end of its prior"),
        (
            Prior(capsule_radius="1 .. 2 mm"),
            "a from .* got 1000 µm as the lower end of its prior; check the units",
        ),
    ],
)
def test_the_refusal_of_a_prior_that_holds_no_shape_names_its_bound(model, experiment, capsule, prior, words):
    with pytest.raises(InputError, match=words):
        Quadrature(model, experiment, prior)(capsule)


def test_a_capsule_of_one_and_a_half_millimetres_is_refused_by_the_bound_of_its_radius(model, experiment, capsule):
    wide = replace(experiment, half_width="1.6 mm")
    with pytest.raises(InputError, match=r"prior.capsule_radius: .* 1000 µm as the upper end of its prior"):
        Quadrature(model, wide)(capsule)
    assert (
        Quadrature(model, wide, Prior(capsule_radius="0.1 .. 5 mm"))(capsule).marginal("capsule_radius").median > 1e-3
    )


MODEL = SimpleNamespace(name="square with pre_inflation", coordinates={"pre_inflation": CoordinateRange(0.0, 0.1, 0.0)})


def of(distribution):
    return Coordinate.all_of(MODEL, Prior(coordinates={"pre_inflation": distribution}))[0]


def test_a_model_without_a_coordinate_has_none_and_takes_no_prior_of_one(model):
    assert Coordinate.all_of(model, Prior()) == ()
    with pytest.raises(InputError, match="bending: expected a coordinate of manufactured polynomial, got a model"):
        Coordinate.all_of(model, Prior(coordinates={"bending": stats.uniform(0.0, 1.0)}))
    with pytest.raises(InputError, match=r"prior: bending: .* got a model of \(Ca, a/l, pre_inflation\)"):
        Coordinate.all_of(MODEL, Prior(coordinates={"bending": stats.uniform(0.0, 1.0)}))


def test_the_default_is_uniform_over_the_range_of_the_model():
    (one,) = Coordinate.all_of(MODEL, Prior())
    np.testing.assert_allclose(one.values([0.0, 0.3, 1.0]), [0.0, 0.03, 0.1])
    np.testing.assert_allclose(np.exp(one.log_density([0.0, 0.05, 0.1])), 10.0)


def test_the_default_of_a_logarithmic_coordinate_is_uniform_in_its_logarithm():
    several = {"bending": CoordinateRange(1e-5, 1e-3, 2e-4, logarithmic=True), **MODEL.coordinates}
    model = SimpleNamespace(name="several", coordinates=several)
    bending, inflation = Coordinate.all_of(model, Prior())
    assert (bending.name, inflation.name) == ("bending", "pre_inflation")
    np.testing.assert_allclose(bending.values([0.0, 0.5, 1.0]), [1e-5, 1e-4, 1e-3])
    np.testing.assert_allclose(inflation.values(0.5), 0.05)
    assert Quantity.of_record(bending.distribution.as_record()) == bending.distribution


@pytest.mark.parametrize("distribution", [stats.norm(0.02, 0.015), stats.uniform(0.0, 0.06), stats.expon(scale=0.02)])
def test_a_distribution_is_cut_to_the_range_and_normalised(distribution):
    one = of(distribution)
    grid = np.linspace(0.0, 0.1, 20_001)
    density = np.exp(one.log_density(grid))
    assert np.trapezoid(density, grid) == pytest.approx(1.0, rel=1e-3)
    assert np.all(np.isneginf(one.log_density([-1e-9, 0.1001, np.nan])))
    for share in (0.1, 0.5, 0.9):
        value = float(one.values(share))
        assert np.trapezoid(density[grid <= value], grid[grid <= value]) == pytest.approx(share, abs=2e-3)


def test_a_prior_far_beyond_the_model_is_refused():
    with pytest.raises(InputError, match=r"expected a distribution within .* 0 to 0\.1, got one with 50%"):
        of(stats.uniform(0.0, 0.2))
    with pytest.raises(InputError, match="0% of its mass"):
        of(stats.norm(0.5, 0.01))


@pytest.mark.parametrize(
    ("text", "median", "spread"),
    [
        ("0 .. 0.1", 0.05, 0.1 / np.sqrt(12.0)),
        ("0..0.1", 0.05, 0.1 / np.sqrt(12.0)),
        ("1e-5..3e-3", 1.505e-3, 2.99e-3 / np.sqrt(12.0)),
        ("0.03 +/- 0.01", 0.03, 0.01),
        ("1.00±.02", 1.0, 0.02),
    ],
)
def test_a_prior_in_text_form(text, median, spread):
    one = coordinate_prior(text, where="prior", key="bending")
    assert (one.ppf(0.5), one.sd) == pytest.approx((median, spread))


@pytest.mark.parametrize("text", ["", "0.03", "0.1..0", "0.03 +/- 0", "0 to 0.1", "0 .. much", 0.03])
def test_a_text_that_is_none_is_refused(text):
    with pytest.raises(InputError, match=r'capsule\.toml: prior: bending: expected a range as "0 \.\. 0\.1" or'):
        Prior().with_texts({"bending": text}, where="capsule.toml: prior")


def test_priors_of_coordinates_are_read_from_the_file_of_the_capsule(tmp_path):
    path = tmp_path / "capsule.toml"
    path.write_text('[prior]\npre_inflation = "0.02 +/- 0.01"\n')
    prior = Prior.read(path)
    assert prior.coordinates["pre_inflation"].mean == pytest.approx(0.02)
    assert prior.with_texts({"pre_inflation": "0..0.05"}).coordinates["pre_inflation"].mean == 0.025
    path.write_text('[prior]\npre_inflaton = "0.02 +/- 0.01"\n')
    with pytest.raises(InputError, match=r"prior\.pre_inflaton: expected one of .*pre_inflation.* an unknown key"):
        Prior.read(path)


def test_intervals_are_equal_tailed_and_hold_what_lies_between_their_ends():
    found = Marginal.of_draws(np.random.default_rng(1).exponential(size=400_000).reshape(100, -1))
    levels = {"median": 0.5, "lower_68": 0.16, "upper_68": 0.84, "lower_95": 0.025, "upper_95": 0.975}
    wanted = {name: stats.expon.ppf(level) for name, level in levels.items()} | {"mean": 1.0, "sd": 1.0}
    assert found.as_dict() == pytest.approx(wanted, abs=0.01, rel=0.01)
    one = Marginal(1.0, 1.0, 1.0, 0.0, 2.0, -1.0, 3.0)
    assert one.contains(0.0, level=68)
    assert not one.contains(2.5, level=68)
    assert one.contains(2.5, level=95)
    assert Marginal.known(2.0) == Marginal(2.0, 0.0, *[2.0] * 5)


DISTRIBUTIONS = {
    "cut normal": (Quantity(2.0, 0.1).distribution, 1e-9),
    "loose cut normal": (Quantity(1.0, 0.5).distribution, 1e-9),
    "normal": (stats.norm(2.0, 0.1), 1e-4),
    "lognormal": (stats.lognorm(0.4, scale=2.0), 1e-3),
    "uniform": (stats.uniform(1.0, 2.0), 1e-3),
    "gamma": (stats.gamma(9.0, scale=0.2), 1e-3),
}


@pytest.mark.parametrize("name", DISTRIBUTIONS)
def test_the_log_density_is_that_of_the_distribution(name):
    frozen, tolerance = DISTRIBUTIONS[name]
    one = Quantity.of(frozen)
    values = frozen.ppf(np.linspace(0.01, 0.99, 51))
    difference = one.logpdf(values) - frozen.logpdf(values)
    assert np.ptp(difference) < 1e3 * tolerance * 1e-2
    assert one.logpdf(np.array([-1.0]))[0] == -np.inf


@pytest.mark.parametrize("name", DISTRIBUTIONS)
@pytest.mark.parametrize("power", [-1, 0, 1])
def test_masses_carry_the_power(name, power):
    frozen, _ = DISTRIBUTIONS[name]
    if name == "loose cut normal" and power < 0:
        pytest.skip("its logarithm has no distribution under 1/x")
    masses = LogGrid.of(Quantity.of(frozen), power)
    values = np.exp(masses.logs)
    norm = frozen.expect(lambda x: x**power, lb=max(frozen.support()[0], 1e-12))
    mean = frozen.expect(lambda x: x ** (power + 1), lb=max(frozen.support()[0], 1e-12)) / norm
    assert masses.masses @ values == pytest.approx(mean, rel=2e-3)


def test_a_narrowed_input_keeps_its_mean():
    for frozen in (Quantity(2.0, 0.1).distribution, stats.uniform(1.0, 2.0), stats.gamma(9.0, scale=0.2)):
        wide = Quantity.of(frozen)
        narrow = LogGrid.of(wide.rescaled(wide.value, 0.5))
        values = np.exp(narrow.logs)
        mean = narrow.masses @ values
        assert mean == pytest.approx(frozen.mean(), rel=1e-3)
        assert np.sqrt(narrow.masses @ (values - mean) ** 2) == pytest.approx(0.5 * frozen.std(), rel=5e-3)


def test_a_velocity_that_is_hardly_measured_is_refused():
    seen = Measurement(axial_extent=2.0, axial_extent_error=0.1, capsule_velocity=1e-3, capsule_velocity_error=0.3e-3)
    experiment = Experiment(cross_section="square", half_width=25e-6, viscosity=0.8)
    with pytest.raises(InputError, match=r"capsule_velocity: expected a standard error below 25% .*, got 30%"):
        Inputs.of(seen, experiment)


def test_a_measurement_without_a_result_is_refused_with_its_reason():
    inputs = Inputs.of_experiment(Experiment(cross_section="square", half_width=25e-6, viscosity=0.85))
    with pytest.raises(InputError, match=r"capsule\.png: status: expected .*, got No capsule was found"):
        inputs.with_velocity_of(Measurement.refused(Status.NO_CAPSULE, source="capsule.png"))
