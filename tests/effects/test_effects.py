"""What each effect of the catalogue does, and that all keep their promises."""

import numpy as np
import pytest

from capsbayes import Surrogate
from capsbayes.database import Database
from capsbayes.diagnosis.blind import distorted, enlarged, in_perspective
from capsbayes.effects import (
    ChannelSwelling,
    FlowRateError,
    HalfWidthApart,
    HalfWidthError,
    Halo,
    ModulusSlope,
    MotionBlur,
    OblongPixels,
    PictureRotation,
    PixelScale,
    RadialDistortion,
    Taper,
    VelocityScale,
    ViscosityError,
    catalogue,
)
from capsbayes.effects.simulated import SIMULATED, Simulated
from capsbayes.errors import DatabaseError, InputError
from capsbayes.model import Effect, Extended
from capsbayes.profile import Profile
from capsbayes.testing import check_effect, check_model

CAPSULES = {"capillary_number": np.array([0.03, 0.06, 0.09]), "size_ratio": np.array([0.8, 0.9, 1.0])}
WIDTH = {"half_width": np.full(3, 25e-6)}
SPEED = {"capsule_velocity": np.full(3, 4e-3)}


@pytest.fixture(scope="module")
def model():
    return Surrogate.open("square-neo-hookean")


def three(value):
    return np.full(3, value)


@pytest.mark.parametrize("name", catalogue())
def test_effects_keep_their_promises(name, model):
    effect = catalogue()[name]
    assert isinstance(effect, Effect)
    check_effect(effect, model)
    check_effect(effect, model + Halo() + PixelScale())


def test_halo_moves_all_edges_out(model):
    theta = CAPSULES | WIDTH | {"halo": three(0.5e-6)}
    seen, without = (model + Halo())(theta, outline=True), model(CAPSULES, outline=True)
    np.testing.assert_allclose(seen.axial_extent - without.axial_extent, 0.04, atol=1e-12)
    np.testing.assert_allclose(seen.parachute_depth, without.parachute_depth, atol=1e-12)
    wider = np.ptp(seen.outline[..., 1], axis=1) - np.ptp(without.outline[..., 1], axis=1)
    np.testing.assert_allclose(wider, 0.04, atol=2e-3)
    np.testing.assert_array_equal(seen.velocity_ratio, without.velocity_ratio)


def test_motion_blur_lengthens_and_does_not_widen(model):
    theta = CAPSULES | WIDTH | SPEED | {"exposure": three(1e-4)}
    seen, without = (model + MotionBlur())(theta, outline=True), model(CAPSULES, outline=True)
    np.testing.assert_allclose(seen.axial_extent - without.axial_extent, 1e-4 * 4e-3 / 25e-6, atol=1e-12)
    wider = np.ptp(seen.outline[..., 1], axis=1) - np.ptp(without.outline[..., 1], axis=1)
    assert np.all(np.abs(wider) < 2e-3)


@pytest.mark.parametrize(
    ("effect", "size", "drawn", "tolerance"),
    [
        (OblongPixels(), 1.03, lambda outline, size: enlarged(outline, size, 1.0), 1e-5),
        (RadialDistortion(), -0.01, distorted, 5e-4),  # geometry is exact, the effect of first order
        (Taper(), 0.01, in_perspective, 5e-4),
    ],
    ids=lambda value: getattr(value, "name", None),
)
def test_faults_of_the_camera_are_those_of_geometry(model, effect, size, drawn, tolerance):
    theta = CAPSULES | {effect.parameter.name: three(size)}
    seen, without = (model + effect)(theta, outline=True), model(CAPSULES, outline=True)
    assert (model + effect)(theta).outline is None
    for row in range(3):
        due = Profile.from_outline(drawn(without.outline[row], size))
        assert seen.axial_length[row] - without.axial_length[row] == pytest.approx(
            due.axial_length - Profile.from_outline(without.outline[row]).axial_length, abs=2.0 * tolerance
        )
        for axis in (0, 1):
            assert np.ptp(seen.outline[row, :, axis]) == pytest.approx(np.ptp(due.points[:, axis]), abs=tolerance)
    moved = np.abs(seen.outline - without.outline - (seen.outline - without.outline).mean(axis=1, keepdims=True))
    assert moved.max() > 5.0 * tolerance


def test_a_rotated_picture_lengthens_a_broad_rear_and_turns_the_outline(model):
    seen = (model + PictureRotation())(CAPSULES | {"rotation": three(0.05)}, outline=True)
    without = model(CAPSULES, outline=True)
    assert np.all(seen.axial_extent > without.axial_extent)
    np.testing.assert_allclose(seen.velocity_ratio, np.cos(0.05) * without.velocity_ratio)
    same = np.hypot(*np.moveaxis(seen.outline, 2, 0)), np.hypot(*np.moveaxis(without.outline, 2, 0))
    np.testing.assert_allclose(*same, atol=1e-12)


@pytest.mark.parametrize(
    ("effect", "lengths", "velocity", "flow"),
    [
        (VelocityScale(), 1.0, 1.02, 1.0),
        (FlowRateError(), 1.0, 1.0, 1.02),
        (HalfWidthError(), 1.0, 1.02, 1.02**-2),
    ],
    ids=lambda value: getattr(value, "name", None),
)
def test_faults_of_velocity_flow_and_width_are_factors(model, effect, lengths, velocity, flow):
    theta = CAPSULES | {effect.parameter.name: three(0.02), "flow_rate": three(1e-11)}
    seen, without = (model + effect)(theta), model(CAPSULES)
    np.testing.assert_allclose(seen.axial_extent, lengths * without.axial_extent)
    np.testing.assert_allclose(seen.velocity_ratio, velocity * without.velocity_ratio)
    np.testing.assert_allclose((model + effect).relative_area(theta), flow)
    with pytest.raises(KeyError, match="flow_rate"):
        (model + effect)(CAPSULES | {effect.parameter.name: three(0.02)})


def test_a_half_width_stated_apart_is_a_pixel_but_for_the_flow(model):
    theta = CAPSULES | {"half_width_apart": three(0.02), "flow_rate": three(1e-11)}
    seen = (model + HalfWidthApart())(theta | {"size_ratio": CAPSULES["size_ratio"] / 1.02})
    np.testing.assert_allclose(seen.axial_extent, model(CAPSULES).axial_extent / 1.02)
    np.testing.assert_allclose((model + HalfWidthApart()).relative_area(theta), 1.02**-2)


def test_oblong_pixels_change_what_is_seen_of_the_velocity_and_the_others_do_not(model):
    plain = model(CAPSULES).velocity_ratio
    np.testing.assert_allclose(
        (model + OblongPixels())(CAPSULES | {"pixel_aspect": three(1.03)}).velocity_ratio, 1.03 * plain
    )
    for effect in (RadialDistortion(), Taper()):
        seen = (model + effect)(CAPSULES | {effect.parameter.name: three(0.01)})
        np.testing.assert_array_equal(seen.velocity_ratio, plain)


def test_swollen_channel_is_a_smaller_capsule_seen_larger(model):
    wider = 1.0 + 5.0 * 4e-3
    seen = (model + ChannelSwelling())(CAPSULES | SPEED | {"swelling": three(5.0)}, outline=True)
    smaller = model(CAPSULES | {"size_ratio": CAPSULES["size_ratio"] / wider}, outline=True)
    np.testing.assert_allclose(seen.axial_length, smaller.axial_length * wider)
    np.testing.assert_allclose(seen.outline, smaller.outline * wider)
    np.testing.assert_array_equal(seen.velocity_ratio, smaller.velocity_ratio)


def test_shape_alone_does_not_tell_a_pixel_from_a_swollen_channel(model):
    """A scale of 1.02 and a channel wider by 2 % are one picture but for what a/l the capsule has."""
    scaled = (model + PixelScale())(CAPSULES | {"pixel_scale": three(0.02)})
    theta = CAPSULES | SPEED | {"size_ratio": CAPSULES["size_ratio"] * 1.02, "swelling": three(5.0)}
    swollen = (model + ChannelSwelling())(theta)
    np.testing.assert_allclose(scaled.axial_extent, swollen.axial_extent, rtol=1e-12)
    np.testing.assert_allclose(scaled.velocity_ratio, 1.02 * swollen.velocity_ratio, rtol=1e-12)


@pytest.mark.parametrize("coordinate", [name for name in SIMULATED if SIMULATED[name].database in Database.shipped()])
def test_simulated_effects_are_those_of_their_database(coordinate, model):
    effect = SIMULATED[coordinate]
    value = three(float(effect.prior.ppf(0.5)))
    due = Surrogate.open(effect.database)(CAPSULES | {coordinate: value}, outline=True)
    added = (model + effect)(CAPSULES | {coordinate: value}, outline=True)
    np.testing.assert_allclose(added.values, due.values, atol=1e-10)
    on_top = (model + PixelScale() + effect)(CAPSULES | {coordinate: value, "pixel_scale": three(0.0)}, outline=True)
    np.testing.assert_allclose(on_top.values, due.values, atol=1e-10)
    np.testing.assert_allclose(on_top.outline, due.outline, atol=1e-10)


def test_two_effects_are_named_and_hashed_in_their_order(model):
    both = model + Halo() + PixelScale()
    assert isinstance(both, Extended)
    assert both.name == "square-neo-hookean + halo + pixel scale"
    assert len({both.sha256, model.sha256, (model + Halo()).sha256, (model + PixelScale() + Halo()).sha256}) == 4
    assert both.domain is model.domain


def test_an_effect_without_its_circumstances_says_which(model):
    with pytest.raises(KeyError, match="motion blur: theta lacks half_width, capsule_velocity"):
        (model + MotionBlur())(CAPSULES | {"exposure": three(1e-4)})
    np.testing.assert_array_equal((model + MotionBlur())(CAPSULES).values, model(CAPSULES).values)


def test_modulus_by_size_shifts_ca_and_nothing_else(model):
    slope = (model + ModulusSlope())(CAPSULES | {"modulus_slope": three(1.0)})
    shifted = CAPSULES["capillary_number"] / (CAPSULES["size_ratio"] / 0.9)
    np.testing.assert_array_equal(slope.values, model(CAPSULES | {"capillary_number": shifted}).values)


def test_wrong_viscosity_is_a_factor_of_ca(model):
    seen = (model + ViscosityError())(CAPSULES | {"viscosity_error": three(0.1)})
    due = model(CAPSULES | {"capillary_number": 1.1 * CAPSULES["capillary_number"]})
    np.testing.assert_allclose(seen.values, due.values, rtol=1e-14)


def test_the_own_error_of_outlines_is_unknown_where_an_effect_reaches_beyond_the_model():
    model = Surrogate.open("square-neo-hookean")
    swollen = model + catalogue()["swelling"]
    theta = {"capillary_number": 0.04, "size_ratio": 1.16, "swelling": 6.0, "capsule_velocity": 5e-3}
    batch = {name: np.array([value]) for name, value in theta.items()}
    assert not model({name: batch[name] for name in model.names}).inside[0]
    assert swollen(batch).inside[0]
    assert swollen.outline_modes(**theta) is None
    assert swollen.outline_modes(**{**theta, "size_ratio": 0.9}).shape[1] > 0


def test_a_model_with_an_effect_keeps_the_contract(model):
    both = model + Halo() + SIMULATED["pre_inflation"]
    check_model(both)
    check_model(both.fixed(halo=0.2e-6))
    assert (both.cross_section, both.view, both.effects) == ("square", "mid-plane", ("halo", "pre_inflation"))
    assert both.circumstances == ("half_width",)
    assert both.fixed(halo=0.2e-6).names == ("capillary_number", "size_ratio", "pre_inflation")


def test_an_unknown_name_is_refused_by_every_kind_of_model(model):
    theta = CAPSULES | {"pre_inflaton": three(0.02)}
    joint = Surrogate.open("square-pre-inflation")
    for one in (model, model + Halo(), (model + Halo()).fixed(halo=0.0), joint, joint.fixed(pre_inflation=0.02)):
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
        theta = CAPSULES | {"strain_hardening": three(hardening)}
        seen, due = (tube + known["strain_hardening"])(theta), Surrogate.open(law)(CAPSULES)
        np.testing.assert_allclose(seen.values, due.values, rtol=0.01)
    skalak = Surrogate.open("circular-skalak") + known["pre_inflation"] + known["area_dilation_modulus"]
    assert skalak(CAPSULES | {"pre_inflation": three(0.02), "area_dilation_modulus": three(2.0)}).inside[:2].all()
    with pytest.raises(DatabaseError):
        (tube + SIMULATED["corner_radius"])(CAPSULES | {"corner_radius": three(0.1)})
