"""Effects that a formula describes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.model import ForwardModel, Kind, Theta
from capsbayes.parameters import PARAMETERS, Parameter
from capsbayes.prediction import Prediction
from capsbayes.profile import vertex_normals
from capsbayes.quantity import Quantity


def displaced(prediction: Prediction, across: Floats, along_flow: Floats) -> Prediction:
    """Displace the edges of a prediction outwards by `across` (n,) [l] along the normals, and `along_flow` (n,) [l]."""
    # The latter is the additional displacement where the normal is along the flow, elsewhere in proportion to its
    # component.
    longer = 2.0 * (across + along_flow)
    moved = replace(
        prediction, axial_extent=prediction.axial_extent + longer, axial_length=prediction.axial_length + longer
    )
    if prediction.outline is None:
        return moved
    normals = vertex_normals(prediction.outline)
    distance = across[:, None] + along_flow[:, None] * np.abs(normals[..., 0])
    return replace(moved, outline=prediction.outline + distance[..., None] * normals)


def scaled(prediction: Prediction, lengths: Floats, velocity: Floats) -> Prediction:
    """Multiply the lengths and the velocity of a prediction by factors (n,)."""
    factors = np.stack([lengths, lengths, velocity], axis=1)
    return replace(
        prediction,
        axial_extent=prediction.axial_extent * lengths,
        axial_length=prediction.axial_length * lengths,
        velocity_ratio=prediction.velocity_ratio * velocity,
        covariance=prediction.covariance * factors[:, :, None] * factors[:, None, :],
        outline=None if prediction.outline is None else prediction.outline * lengths[:, None, None],
    )


def warped(prediction: Prediction, displacement: Callable[[Floats], Floats], *, outline: bool) -> Prediction:
    """Displace a prediction by a field of the place in the picture, whose middle is that of the capsule."""
    # `displacement` maps places (n, k, 2) [l], columns along and across the flow, to displacements (n, k, 2) [l]. The
    # prediction has its outline, if the model has it: the rear rim is off the axis.
    half = 0.5 * prediction.axial_extent
    on_axis = np.zeros((len(half), 3, 2))
    on_axis[..., 0] = np.stack([half, -half, half - prediction.axial_length], axis=1)
    nose, end, hollow = displacement(on_axis)[..., 0].T
    moved, longer = None, nose - end
    if prediction.outline is not None:
        along = prediction.outline[..., 0]
        middle = 0.5 * (along.max(axis=1) + along.min(axis=1))
        moved = prediction.outline + displacement(prediction.outline - middle[:, None, None] * [1.0, 0.0])
        longer = np.ptp(moved[..., 0], axis=1) - np.ptp(along, axis=1)
    return replace(
        prediction,
        axial_extent=prediction.axial_extent + longer,
        axial_length=prediction.axial_length + nose - hollow,
        outline=moved if outline else None,
    )


# A size ratio, as every length, is over the half width that is stated; Ca is that of the mean velocity at the capsule


@dataclass(frozen=True)
class Analytic:
    """Effect of a size, the `parameter`, whose distribution is the `prior` [SI]; see `capsbayes.model.Effect`.

    A subclass sets what has no default here, and predicts when it is called.
    """

    prior: Quantity
    name: ClassVar[str]
    parameter: ClassVar[Parameter]
    null_value: ClassVar[float] = 0.0
    kind: ClassVar[Kind] = Kind.SESSION
    circumstances: ClassVar[tuple[str, ...]] = ()
    changes: ClassVar[str]
    separated_by: ClassVar[str]


def _either_way(error: float, unit: str = "") -> Quantity:
    """Return a normal prior about zero of a size that may be negative."""
    return Quantity(0.0, error, unit, low=-math.inf)


@dataclass(frozen=True)
class Halo(Analytic):
    """Displacement of all edges along their normals by one distance [m], by diffraction or the threshold."""

    prior: Quantity = _either_way(0.5e-6, "m")
    name = "halo"
    parameter = PARAMETERS["halo"]
    circumstances = ("half_width",)
    changes = (
        "L_z and L_a are larger by twice the displacement, L_p is the same; the relative change is largest for small "
        "capsules."
    )
    separated_by = "A picture of a bead of known diameter."

    def __call__(self, model: ForwardModel, theta: Theta, *, outline: bool = False) -> Prediction:
        distance = theta["halo"] / theta["half_width"]
        return displaced(model(theta, outline=outline), distance, np.zeros_like(distance))


@dataclass(frozen=True)
class MotionBlur(Analytic):
    """Edges detected at the outer ends of their blur, which is as long as the path during the exposure [s]."""

    prior: Quantity = Quantity.log_uniform(1e-6, 1e-3, "s")
    name = "motion blur"
    parameter = PARAMETERS["exposure"]
    kind = Kind.SPEED
    circumstances = ("half_width", "capsule_velocity")
    changes = "Nose and rear are blurred and lie farther out, the more so the faster the capsule; the flanks are sharp."
    separated_by = "The width of the edges at nose and flanks, or the exposure of the camera."

    def __call__(self, model: ForwardModel, theta: Theta, *, outline: bool = False) -> Prediction:
        path = theta["exposure"] * theta["capsule_velocity"] / theta["half_width"]
        return displaced(model(theta, outline=outline), np.zeros_like(path), 0.5 * path)


@dataclass(frozen=True)
class PixelScale(Analytic):
    """Relative error of the scale of lengths and velocity, where the half width is known independently."""

    prior: Quantity = _either_way(0.01)
    name = "pixel scale"
    parameter = PARAMETERS["pixel_scale"]
    changes = (
        "Lengths over l and velocity are larger by one factor; from the shape alone it resembles a swollen channel."
    )
    separated_by = "The walls in the same picture, or a ruled slide; another flow rate distinguishes it from swelling."

    def __call__(self, model: ForwardModel, theta: Theta, *, outline: bool = False) -> Prediction:
        factor = 1.0 + theta["pixel_scale"]
        return scaled(model(theta, outline=outline), factor, factor)


@dataclass(frozen=True)
class OblongPixels(Analytic):
    """Height of a pixel over its width, the flow along the rows, with a half width that is read across it."""

    prior: Quantity = Quantity(1.0, 0.02)
    name = "oblong pixels"
    parameter = PARAMETERS["pixel_aspect"]
    null_value = 1.0
    changes = "Lengths and velocity along the flow are larger by one factor; what is read across it is right."
    separated_by = "A bead or a ruled slide, of which both directions are measured on the same camera."

    def __call__(self, model: ForwardModel, theta: Theta, *, outline: bool = False) -> Prediction:
        aspect, seen = theta["pixel_aspect"], model(theta, outline=outline)
        stretched = scaled(seen, aspect, aspect)
        if seen.outline is None:
            return stretched
        along_and_across = np.stack([aspect, np.ones_like(aspect)], axis=1)
        return replace(stretched, outline=seen.outline * along_and_across[:, None])


@dataclass(frozen=True)
class RadialDistortion(Analytic):
    """Relative change of the magnification a half width from the middle of the picture; negative for a barrel.

    It grows with the square of the distance from the middle, which is taken to be that of the capsule on the axis. The
    half width is read next to it: there the wall itself is a half width away, so that this distance is right.
    """

    prior: Quantity = _either_way(0.01)
    name = "radial distortion"
    parameter = PARAMETERS["distortion"]
    changes = (
        "What is nearer to the middle of the picture than the walls looks too large in a barrel, what is farther too "
        "small: flanks move outwards, the ends of long capsules inwards."
    )
    separated_by = "A ruled slide that fills the picture; the bend of straight walls."

    def __call__(self, model: ForwardModel, theta: Theta, *, outline: bool = False) -> Prediction:
        size, seen = theta["distortion"][:, None, None], model(theta, outline=True)
        return warped(seen, lambda at: size * (np.sum(at**2, axis=-1, keepdims=True) - 1.0) * at, outline=outline)


@dataclass(frozen=True)
class Taper(Analytic):
    """Relative growth of the magnification along a half width of the flow, as of a channel tilted to the focal plane.

    To first order in the tilt nothing else changes. A lens at a distance D from a channel that is tilted by an angle
    has a taper of tan(angle) l/D; a telecentric one has none.
    """

    prior: Quantity = _either_way(0.005)
    name = "tilt of the optical axis"
    parameter = PARAMETERS["taper"]
    changes = "One end of the capsule looks broader and farther out, the other narrower; L_z is the same."
    separated_by = "The walls, which are not parallel in the picture."

    def __call__(self, model: ForwardModel, theta: Theta, *, outline: bool = False) -> Prediction:
        size, seen = theta["taper"][:, None, None], model(theta, outline=True)
        return warped(seen, lambda at: size * at[..., :1] * at, outline=outline)


@dataclass(frozen=True)
class PictureRotation(Analytic):
    """Angle [rad], in either sense, between the flow and the rows along which lengths and velocities are read.

    An outline is turned, which its own tilt absorbs. The extent along the rows grows, as a rim of the rear moves back;
    the length on the axis is read along a row through the nose.
    """

    prior: Quantity = Quantity.uniform(0.0, 0.1)
    name = "rotation of the picture"
    parameter = PARAMETERS["rotation"]
    changes = "L_z read along the rows is too large where the rear is broad; outlines are only turned."
    separated_by = "The walls, which are not along the rows of the picture."

    def __call__(self, model: ForwardModel, theta: Theta, *, outline: bool = False) -> Prediction:
        seen = model(theta, outline=True)
        assert seen.outline is not None, "asked for"
        cosine, sine = np.cos(theta["rotation"]), np.sin(theta["rotation"])
        turn = np.moveaxis(np.array([[cosine, sine], [-sine, cosine]]), 2, 0)
        turned = seen.outline @ turn
        longer = np.ptp(turned[..., 0], axis=1) - np.ptp(seen.outline[..., 0], axis=1)
        return replace(
            seen,
            axial_extent=seen.axial_extent + longer,
            axial_length=seen.axial_length * cosine,
            velocity_ratio=seen.velocity_ratio * cosine,
            outline=turned if outline else None,
        )


@dataclass(frozen=True)
class VelocityScale(Analytic):
    """Relative error of all velocities, by a wrong frame rate or a wrong delay between two pictures.

    As the three effects that follow, it shows only in the flow rates, so that it is tried where these are stated.
    """

    prior: Quantity = _either_way(0.05)
    name = "velocity scale"
    parameter = PARAMETERS["velocity_scale"]
    circumstances = ("flow_rate",)
    changes = (
        "No shape; v_o is larger than the flow rate and the size of the capsule allow, and G_s of all capsules by the "
        "same factor."
    )
    separated_by = "The frame rate by a lamp of known period, or the velocity of a bead on a moving stage."

    def factor(self, theta: Theta) -> Floats:
        """Return the stated value over the true one : (n,) array."""
        return np.asarray(1.0 + theta[self.parameter.name])

    def __call__(self, model: ForwardModel, theta: Theta, *, outline: bool = False) -> Prediction:
        factor = self.factor(theta)
        return scaled(model(theta, outline=outline), np.ones_like(factor), factor)


@dataclass(frozen=True)
class FlowRateError(VelocityScale):
    """Relative error of all stated flow rates, by a leak, a soft tube or a wrong syringe."""

    name = "flow rate"
    parameter = PARAMETERS["flow_rate_error"]
    changes = "No shape and no G_s; v_o is smaller than the flow rate and the size of the capsule say."
    separated_by = "The liquid that leaves the channel in a known time, weighed."

    def __call__(self, model: ForwardModel, theta: Theta, *, outline: bool = False) -> Prediction:
        return model(theta, outline=outline)  # shape and velocity are those of the true flow rate

    def relative_flow(self, theta: Theta) -> Floats:
        """Return the stated flow rate over the true one : (n,) array."""
        return self.factor(theta)


@dataclass(frozen=True)
class HalfWidthError(VelocityScale):
    """Relative error of the half width beyond the experiment's, where the walls in the same picture are the scale.

    Lengths over l are right then. Velocities are wrong by the same factor, and the mean velocity that follows from the
    flow rate by its square, in the other direction.
    """

    prior: Quantity = _either_way(0.03)
    name = "half width in the picture"
    parameter = PARAMETERS["half_width_error"]
    changes = "No shape; v_o and G_s of all capsules are wrong by the factor of the width, v_o over Q/A by its cube."
    separated_by = "A ruled slide next to the walls, or a cut through the channel under the microscope."

    def relative_flow(self, theta: Theta) -> Floats:
        """Return the area of the true cross-section over that of the stated one : (n,) array."""
        return np.asarray(self.factor(theta) ** -2.0)


@dataclass(frozen=True)
class HalfWidthApart(HalfWidthError):
    """Relative error of the half width beyond the experiment's, where the scale of the picture is known independently.

    Lengths over l are too small if it is positive, as with too small pixels; only the flow rate distinguishes the two.
    """

    prior: Quantity = _either_way(0.02)
    name = "half width stated apart"
    parameter = PARAMETERS["half_width_apart"]
    changes = (
        "Lengths over l are too small by one factor as by the size of a pixel; v_o over Q/A too large by its square."
    )
    separated_by = "The distance of the walls in the picture, or a cut through the channel."

    def __call__(self, model: ForwardModel, theta: Theta, *, outline: bool = False) -> Prediction:
        factor = self.factor(theta)
        seen = model({**theta, "size_ratio": theta["size_ratio"] * factor}, outline=outline)
        return scaled(seen, 1.0 / factor, np.ones_like(factor))


@dataclass(frozen=True)
class ChannelSwelling(Analytic):
    """Relative widening of a soft channel per velocity of the capsule [s/m], as a measure of the flow's pressure.

    PDMS widens by up to 9 %.
    """

    prior: Quantity = Quantity.log_uniform(0.05, 10.0, "s/m")
    name = "channel swelling"
    parameter = PARAMETERS["swelling"]
    kind = Kind.SPEED
    circumstances = ("capsule_velocity",)
    changes = "The gap is wider than the nominal one; the apparent G_s drifts with the flow rate."
    separated_by = (
        "The distance between the walls in the picture at each flow rate, or a second distance from the outlet."
    )

    def __call__(self, model: ForwardModel, theta: Theta, *, outline: bool = False) -> Prediction:
        wider = self._widening(theta)
        seen = model({**theta, "size_ratio": theta["size_ratio"] / wider}, outline=outline)
        return scaled(seen, wider, np.ones_like(wider))

    def relative_flow(self, theta: Theta) -> Floats:
        """Return the area of the swollen cross-section over that of the nominal one : (n,) array."""
        return self._widening(theta) ** 2

    def _widening(self, theta: Theta) -> Floats:
        return np.asarray(1.0 + theta["swelling"] * theta["capsule_velocity"])


@dataclass(frozen=True)
class ModulusSlope(Analytic):
    """Exponent of G_s as a power of the size ratio; ``capillary_number`` is that of a capsule of the `reference`."""

    prior: Quantity = _either_way(1.0)
    reference: float = 0.9
    name = "modulus by size"
    parameter = PARAMETERS["modulus_slope"]
    changes = "No shape; the apparent G_s drifts with the size."
    separated_by = "Capsules of one size at several flow rates: their G_s is the same."

    def __call__(self, model: ForwardModel, theta: Theta, *, outline: bool = False) -> Prediction:
        stiffer = np.power(theta["size_ratio"] / self.reference, theta["modulus_slope"])
        return model({**theta, "capillary_number": theta["capillary_number"] / stiffer}, outline=outline)


@dataclass(frozen=True)
class ViscosityError(Analytic):
    """Relative error of the viscosity beyond the experiment's; ``capillary_number`` is that of the assumed one.

    All moduli are wrong by one factor, which shapes and velocities do not show; the catalogue lists it so that
    tables state this.
    """

    prior: Quantity = _either_way(0.1)
    name = "viscosity"
    parameter = PARAMETERS["viscosity_error"]
    changes = "Nothing visible; G_s of all capsules is wrong by one factor."
    separated_by = "A viscometer at the temperature of the channel."
    unseen_because = "Shapes depend on viscosity and G_s through Ca alone, which is free."

    def __call__(self, model: ForwardModel, theta: Theta, *, outline: bool = False) -> Prediction:
        factor = 1.0 + theta["viscosity_error"]
        return model({**theta, "capillary_number": theta["capillary_number"] * factor}, outline=outline)


ANALYTIC = (
    *(Halo, MotionBlur, PixelScale, OblongPixels, RadialDistortion, Taper, PictureRotation, VelocityScale),
    *(FlowRateError, HalfWidthError, HalfWidthApart, ChannelSwelling, ModulusSlope, ViscosityError),
)
"""Classes of the effects, in the order of the catalogue."""
