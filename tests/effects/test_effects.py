"""What each effect of the catalogue does, that all keep their promises, and that `check_effect` names a broken one."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy import stats

from capsbayes import Surrogate
from capsbayes.database import Database
from capsbayes.diagnosis.blind import distorted, enlarged, in_perspective
from capsbayes.effects import SIMULATED, Halo, Simulated, catalogue
from capsbayes.errors import BrokenPromiseError, DatabaseError, InputError
from capsbayes.model import Effect, Extended
from capsbayes.profile import Profile
from capsbayes.quantity import Quantity
from capsbayes.testing import check_effect, check_model

CAPSULES = {"capillary_number": np.array([0.03, 0.06, 0.09]), "size_ratio": np.array([0.8, 0.9, 1.0])}
CIRCUMSTANCES = {"half_width": 25e-6, "capsule_velocity": 4e-3, "flow_rate": 1e-11}
KNOWN = catalogue()


@pytest.fixture(scope="module")
def model():
    return Surrogate.open("square-neo-hookean")


def three(value):
    return np.full(3, value)


def seen_with(model, *, scaled_size=1.0, **sizes):
    """Return the prediction with effects, and that without them."""
    for name in sizes:
        model = model + KNOWN[name]
    theta = CAPSULES | {"size_ratio": scaled_size * CAPSULES["size_ratio"]}
    given = {name: three(value) for name, value in (CIRCUMSTANCES | sizes).items()}
    return model(theta | given, outline=True), model(CAPSULES, outline=True)


def width(prediction):
    return np.ptp(prediction.outline[..., 1], axis=1)


@pytest.mark.parametrize("name", KNOWN)
def test_effects_keep_their_promises(name, model):
    assert isinstance(KNOWN[name], Effect)
    check_effect(KNOWN[name], model)
    check_effect(KNOWN[name], model + KNOWN["halo"] + KNOWN["pixel_scale"])


class Wordless(Halo):
    changes = ""


class Restless(Halo):
    null_value = 1e-7


@dataclass(frozen=True)
class Changed(Halo):
    """A halo whose prediction is then changed."""

    change: Callable | None = None

    def __call__(self, model, theta, *, outline=False):
        return self.change(super().__call__(model, theta, outline=outline), model, theta)


def idle(seen, model, theta):
    return model(theta, outline=True)


def boundless(seen, model, theta):
    return replace(seen, inside=np.ones_like(seen.inside))


def first_alike(seen, model, theta):
    return replace(seen, axial_extent=np.where(theta["halo"] != 0.0, seen.axial_extent[0], seen.axial_extent))


def meddling(seen, model, theta):
    theta["halo"][:] *= 1.1
    return seen


def lengths_only(seen, model, theta):
    return replace(seen, outline=None if seen.outline is None else model(theta, outline=True).outline)


@pytest.mark.parametrize(
    ("effect", "promise"),
    [
        (Wordless(), "it has a name, sentences"),
        (Halo(stats.norm(0.0, 5e-7)), "prior is a rv_continuous_frozen, not a Quantity"),
        (Restless(), "at its null value it changes nothing"),
        (Changed(change=idle), "at a typical size it changes something"),
        (Changed(change=first_alike), "it treats each capsule of a batch by itself"),
        (Changed(change=meddling), "it changes the arrays that it is given"),
        (Changed(change=boundless), "outside the domain of the model it has no answer"),
        (Changed(Quantity(0.0, 5e-6, "m", low=-np.inf), lengths_only), "it moves the outline as it moves the lengths"),
    ],
)
def test_the_broken_promise_is_named(effect, promise, model):
    with pytest.raises(BrokenPromiseError, match=promise):
        check_effect(effect, model)


def test_edges_are_displaced_by_a_halo_everywhere_and_by_blur_along_the_flow_alone(model):
    for sizes, longer, tolerance in (({"halo": 0.5e-6}, 0.04, 0.0), ({"exposure": 1e-4}, 0.016, 0.016)):
        seen, without = seen_with(model, **sizes)
        np.testing.assert_allclose(seen.axial_extent - without.axial_extent, longer, atol=1e-12)
        np.testing.assert_allclose(seen.parachute_depth, without.parachute_depth, atol=1e-12)
        np.testing.assert_allclose(width(seen) - width(without), longer - tolerance, atol=2e-3)
        np.testing.assert_array_equal(seen.velocity_ratio, without.velocity_ratio)


@pytest.mark.parametrize(
    ("name", "size", "drawn", "tolerance", "faster"),
    [
        ("pixel_aspect", 1.03, lambda outline, size: enlarged(outline, size, 1.0), 1e-5, 1.03),
        ("distortion", -0.01, distorted, 5e-4, 1.0),  # geometry is exact, the effect of first order
        ("taper", 0.01, in_perspective, 5e-4, 1.0),
    ],
)
def test_faults_of_the_camera_are_those_of_geometry(model, name, size, drawn, tolerance, faster):
    seen, without = seen_with(model, **{name: size})
    assert (model + KNOWN[name])(CAPSULES | {name: three(size)}).outline is None
    np.testing.assert_allclose(seen.velocity_ratio, faster * without.velocity_ratio, rtol=1e-15)
    for row in range(3):
        due = Profile.from_outline(drawn(without.outline[row], size))
        longer = due.axial_length - Profile.from_outline(without.outline[row]).axial_length
        assert seen.axial_length[row] - without.axial_length[row] == pytest.approx(longer, abs=2.0 * tolerance)
        for axis in (0, 1):
            assert np.ptp(seen.outline[row, :, axis]) == pytest.approx(np.ptp(due.points[:, axis]), abs=tolerance)
    moved = np.abs(seen.outline - without.outline - (seen.outline - without.outline).mean(axis=1, keepdims=True))
    assert moved.max() > 5.0 * tolerance


def test_a_rotated_picture_lengthens_a_broad_rear_and_turns_the_outline(model):
    seen, without = seen_with(model, rotation=0.05)
    assert np.all(seen.axial_extent > without.axial_extent)
    np.testing.assert_allclose(seen.velocity_ratio, np.cos(0.05) * without.velocity_ratio)
    distances = (np.hypot(*np.moveaxis(each.outline, 2, 0)) for each in (seen, without))
    np.testing.assert_allclose(*distances, atol=1e-12)
    assert seen.outline[0, 10, 1] > without.outline[0, 10, 1]  # not the other way round


@pytest.mark.parametrize(
    ("name", "true_size", "lengths", "velocity", "flow"),
    [
        ("velocity_scale", 1.0, 1.0, 1.02, 1.0),
        ("flow_rate_error", 1.0, 1.0, 1.0, 1.02),
        ("half_width_error", 1.0, 1.0, 1.02, 1.02**-2),
        ("half_width_apart", 1.0 / 1.02, 1.0 / 1.02, 1.0, 1.02**-2),
        ("pixel_scale", 1.0, 1.02, 1.02, 1.0),
        ("swelling", 1.02, 1.02, 1.0, 1.02**2),
    ],
)
def test_faults_of_velocity_flow_and_width_are_factors(model, name, true_size, lengths, velocity, flow):
    size = 0.02 / CIRCUMSTANCES["capsule_velocity"] if name == "swelling" else 0.02
    seen, without = seen_with(model, scaled_size=true_size, **{name: size})
    np.testing.assert_allclose(seen.axial_extent, lengths * without.axial_extent, rtol=1e-12)
    np.testing.assert_allclose(seen.axial_length, lengths * without.axial_length, rtol=1e-12)
    np.testing.assert_allclose(seen.outline, lengths * without.outline, rtol=1e-12)
    np.testing.assert_allclose(seen.velocity_ratio, velocity * without.velocity_ratio, rtol=1e-12)
    given = {key: three(value) for key, value in (CIRCUMSTANCES | {name: size}).items()}
    np.testing.assert_allclose((model + KNOWN[name]).relative_area(CAPSULES | given), flow)


def test_size_and_viscosity_shift_ca_and_nothing_else(model):
    for name, size, factor in (
        ("modulus_slope", 1.0, 0.9 / CAPSULES["size_ratio"]),
        ("viscosity_error", 0.1, 1.1),
    ):
        seen, _ = seen_with(model, **{name: size})
        due = model(CAPSULES | {"capillary_number": factor * CAPSULES["capillary_number"]})
        np.testing.assert_allclose(seen.values, due.values, rtol=1e-13)


@pytest.mark.parametrize("coordinate", [name for name in SIMULATED if SIMULATED[name].database in Database.shipped()])
def test_simulated_effects_are_those_of_their_database(coordinate, model):
    effect = SIMULATED[coordinate]
    value = float(effect.prior.ppf(0.5))
    due = Surrogate.open(effect.database)(CAPSULES | {coordinate: three(value)}, outline=True)
    np.testing.assert_allclose(seen_with(model, **{coordinate: value})[0].values, due.values, atol=1e-10)
    on_top, _ = seen_with(model, pixel_scale=0.0, **{coordinate: value})
    np.testing.assert_allclose(on_top.values, due.values, atol=1e-10)
    np.testing.assert_allclose(on_top.outline, due.outline, atol=1e-10)


def test_effects_are_named_hashed_and_asked_for_their_circumstances_in_their_order(model):
    halo, scale = KNOWN["halo"], KNOWN["pixel_scale"]
    both = model + halo + scale
    assert isinstance(both, Extended)
    assert both.name == "square-neo-hookean + halo + pixel scale"
    assert len({each.sha256 for each in (both, model, model + halo, model + scale + halo)}) == 4
    assert both.domain is model.domain
    blurred = model + KNOWN["exposure"]
    with pytest.raises(KeyError, match="motion blur: theta lacks half_width, capsule_velocity"):
        blurred(CAPSULES | {"exposure": three(1e-4)})
    np.testing.assert_array_equal(blurred(CAPSULES).values, model(CAPSULES).values)
    for name in ("velocity_scale", "flow_rate_error", "half_width_error", "half_width_apart"):
        with pytest.raises(KeyError, match="flow_rate"):
            (model + KNOWN[name])(CAPSULES | {name: three(0.02)})


def test_the_own_error_of_outlines_is_unknown_where_an_effect_reaches_beyond_the_model(model):
    swollen = model + KNOWN["swelling"]
    theta = {"capillary_number": 0.04, "size_ratio": 1.16, "swelling": 6.0, "capsule_velocity": 5e-3}
    batch = {name: np.array([value]) for name, value in theta.items()}
    assert not model({name: batch[name] for name in model.names}).inside[0]
    assert swollen(batch).inside[0]
    assert swollen.outline_modes(**theta) is None
    assert swollen.outline_modes(**{**theta, "size_ratio": 0.9}).shape[1] > 0


def test_a_model_with_an_effect_keeps_the_contract(model):
    both = model + KNOWN["halo"] + SIMULATED["pre_inflation"]
    check_model(both)
    check_model(both.fixed(halo=0.2e-6))
    assert (both.cross_section, both.view, both.effects) == ("square", "mid-plane", ("halo", "pre_inflation"))
    assert both.circumstances == ("half_width",)
    assert both.fixed(halo=0.2e-6).names == ("capillary_number", "size_ratio", "pre_inflation")


def test_an_unknown_name_is_refused_by_every_kind_of_model(model):
    theta, halo = CAPSULES | {"pre_inflaton": three(0.02)}, KNOWN["halo"]
    joint = Surrogate.open("square-pre-inflation")
    for one in (model, model + halo, (model + halo).fixed(halo=0.0), joint, joint.fixed(pre_inflation=0.02)):
        with pytest.raises(InputError, match=r"theta: expected names among capillary_number, .*'pre_inflaton'"):
            one(theta)
    with pytest.raises(InputError, match="fixed parameters: expected names among pre_inflation, got 'pre_inflaton'"):
        joint.fixed(pre_inflaton=0.02)
    with pytest.raises(InputError, match="expected no names, as it has no parameters to fix, got 'halo'"):
        model.fixed(halo=0.0)


def test_a_circular_tube_has_the_effects_of_the_membrane():
    tube, known = Surrogate.open("circular-neo-hookean"), catalogue("circular")
    of_membrane = [name for name in known if isinstance(known[name], Simulated)]
    assert of_membrane == [name for name in SIMULATED if SIMULATED[name].of_membrane]
    for name in of_membrane:
        check_effect(known[name], tube)
    for law, hardening in (("circular-neo-hookean", 0.0), ("circular-skalak", 1.0)):
        seen = (tube + known["strain_hardening"])(CAPSULES | {"strain_hardening": three(hardening)})
        np.testing.assert_allclose(seen.values, Surrogate.open(law)(CAPSULES).values, rtol=0.01)
    skalak = Surrogate.open("circular-skalak") + known["pre_inflation"] + known["area_dilation_modulus"]
    assert skalak(CAPSULES | {"pre_inflation": three(0.02), "area_dilation_modulus": three(2.0)}).inside[:2].all()
    with pytest.raises(DatabaseError):
        (tube + SIMULATED["corner_radius"])(CAPSULES | {"corner_radius": three(0.1)})
