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

# Predictions with displaced edges, with scaled lengths, and as seen through a lens that magnifies unevenly


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


def stretched(prediction: Prediction, along_flow: Floats) -> Prediction:
    """Multiply what a prediction has along the flow, the velocity included, by factors (n,)."""
    made = scaled(prediction, along_flow, along_flow)
    if prediction.outline is None:
        return made
    factors = np.stack([along_flow, np.ones_like(along_flow)], axis=1)
    return replace(made, outline=prediction.outline * factors[:, None, :])


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


# What effects have in common that only the flow rates show: relative errors of all capsules of a session


class OfFlowRates:
    """Relative error that all capsules of a session share, tried where flow rates are stated."""

    parameter: ClassVar[Parameter]
    null_value: ClassVar[float] = 0.0
    kind: ClassVar[Kind] = Kind.SESSION
    circumstances: ClassVar[tuple[str, ...]] = ("flow_rate",)

    def factor(self, theta: Theta) -> Floats:
        """Return the stated value over the true one : (n,) array."""
        return np.asarray(1.0 + theta[self.parameter.name])


class OfHalfWidth(OfFlowRates):
    """Relative error of the stated half width."""

    def relative_flow(self, theta: Theta) -> Floats:
        """Return the area of the true cross-section over that of the stated one : (n,) array."""
        return np.asarray(self.factor(theta) ** -2.0)


# Wrong half width, by which lengths in metres were divided


@dataclass(frozen=True)
class HalfWidthApart(OfHalfWidth):
    """Stated half width larger than the true one, where the scale of the picture is known independently of it.

    Lengths over l are too small then, as with too small pixels; only the flow rate distinguishes the two, so that
    the effect is tried where it is known. The size ratio is over the stated half width.

    Parameters
    ----------
    prior : Quantity
        Of the relative error, in addition to that of the experiment.
    """

    prior: Quantity = Quantity(0.0, 0.02, low=-math.inf)
    name: ClassVar[str] = "half width stated apart"
    parameter: ClassVar[Parameter] = PARAMETERS["half_width_apart"]
    changes: ClassVar[str] = (
        "Lengths over l are too small by one factor as by the size of a pixel; v_o over Q/A too large by its square."
    )
    separated_by: ClassVar[str] = "The distance of the walls in the picture, or a cut through the channel."

    def __call__(self, model: ForwardModel, theta: Theta, *, outline: bool = False) -> Prediction:
        """Predict in the true channel, over the stated half width."""
        factor = self.factor(theta)
        prediction = model({**theta, "size_ratio": theta["size_ratio"] * factor}, outline=outline)
        return scaled(prediction, 1.0 / factor, np.ones_like(factor))


# Widening of a soft channel by the pressure of the flow


@dataclass(frozen=True)
class ChannelSwelling:
    """Half width larger than the nominal one, in proportion to the velocity of the capsule as a measure of the flow.

    Size ratio and lengths are over the nominal half width; Ca is that of the mean velocity at the capsule.

    Parameters
    ----------
    prior : Quantity [s/m]
        Of the relative widening per velocity; PDMS widens by up to 9 %.
    """

    prior: Quantity = Quantity.log_uniform(0.05, 10.0, "s/m")
    name: ClassVar[str] = "channel swelling"
    parameter: ClassVar[Parameter] = PARAMETERS["swelling"]
    null_value: ClassVar[float] = 0.0
    kind: ClassVar[Kind] = Kind.SPEED
    circumstances: ClassVar[tuple[str, ...]] = ("capsule_velocity",)
    changes: ClassVar[str] = "The gap is wider than the nominal one; the apparent G_s drifts with the flow rate."
    separated_by: ClassVar[str] = (
        "The distance between the walls in the picture at each flow rate, or a second distance from the outlet."
    )

    def __call__(self, model: ForwardModel, theta: Theta, *, outline: bool = False) -> Prediction:
        """Predict in the wider channel, over the nominal half width."""
        wider = 1.0 + theta["swelling"] * theta["capsule_velocity"]
        prediction = model({**theta, "size_ratio": theta["size_ratio"] / wider}, outline=outline)
        return scaled(prediction, wider, np.ones_like(wider))

    def relative_flow(self, theta: Theta) -> Floats:
        """Return the area of the swollen cross-section over that of the nominal one : (n,) array."""
        return np.asarray((1.0 + theta["swelling"] * theta["capsule_velocity"]) ** 2)


# Flow rates that are all wrong by one factor


@dataclass(frozen=True)
class FlowRateError(OfFlowRates):
    """Stated flow rates larger than the true ones by one factor, by a leak, a soft tube or a wrong syringe.

    Parameters
    ----------
    prior : Quantity
        Of the relative error.
    """

    prior: Quantity = Quantity(0.0, 0.05, low=-math.inf)
    name: ClassVar[str] = "flow rate"
    parameter: ClassVar[Parameter] = PARAMETERS["flow_rate_error"]
    changes: ClassVar[str] = "No shape and no G_s; v_o is smaller than the flow rate and the size of the capsule say."
    separated_by: ClassVar[str] = "The liquid that leaves the channel in a known time, weighed."

    def __call__(self, model: ForwardModel, theta: Theta, *, outline: bool = False) -> Prediction:
        """Predict what the model does: shape and velocity are those of the true flow rate."""
        return model(theta, outline=outline)

    def relative_flow(self, theta: Theta) -> Floats:
        """Return the stated flow rate over the true one : (n,) array."""
        return self.factor(theta)


# Wrong half width, where the walls in the picture give the scale


@dataclass(frozen=True)
class HalfWidthError(OfHalfWidth):
    """Stated half width larger than the true one, where lengths are measured against the walls in the same picture.

    Lengths over l are right then. Velocities are wrong by the same factor, and the mean velocity that follows from the
    flow rate by its square, in the other direction.

    Parameters
    ----------
    prior : Quantity
        Of the relative error, in addition to that of the experiment.
    """

    prior: Quantity = Quantity(0.0, 0.03, low=-math.inf)
    name: ClassVar[str] = "half width in the picture"
    parameter: ClassVar[Parameter] = PARAMETERS["half_width_error"]
    changes: ClassVar[str] = (
        "No shape; v_o and G_s of all capsules are wrong by the factor of the width, v_o over Q/A by its cube."
    )
    separated_by: ClassVar[str] = "A ruled slide next to the walls, or a cut through the channel under the microscope."

    def __call__(self, model: ForwardModel, theta: Theta, *, outline: bool = False) -> Prediction:
        """Scale the velocities that a model predicts."""
        factor = self.factor(theta)
        return scaled(model(theta, outline=outline), np.ones_like(factor), factor)


# Displacement of the detected edge by a halo of diffraction, or by the threshold


@dataclass(frozen=True)
class Halo:
    """Displacement of all edges along their normals by the same distance.

    Parameters
    ----------
    prior : Quantity [m]
        Of the displacement.
    """

    prior: Quantity = Quantity(0.0, 0.5e-6, "m", low=-np.inf)
    name: ClassVar[str] = "halo"
    parameter: ClassVar[Parameter] = PARAMETERS["halo"]
    null_value: ClassVar[float] = 0.0
    kind: ClassVar[Kind] = Kind.SESSION
    circumstances: ClassVar[tuple[str, ...]] = ("half_width",)
    changes: ClassVar[str] = (
        "L_z and L_a are larger by twice the displacement, L_p is the same; the relative change is largest for small "
        "capsules."
    )
    separated_by: ClassVar[str] = "A picture of a bead of known diameter."

    def __call__(self, model: ForwardModel, theta: Theta, *, outline: bool = False) -> Prediction:
        """Displace the edges that a model predicts."""
        distance = theta["halo"] / theta["half_width"]
        return displaced(model(theta, outline=outline), distance, np.zeros_like(distance))


# Membranes that are stiffer the larger the capsule


@dataclass(frozen=True)
class ModulusSlope:
    """G_s as a power of the size; ``capillary_number`` is then that of a capsule of the reference size.

    Parameters
    ----------
    prior : Quantity
        Of the exponent.
    reference : float
        Size ratio at which G_s is stated.
    """

    prior: Quantity = Quantity(0.0, 1.0, low=-np.inf)
    reference: float = 0.9
    name: ClassVar[str] = "modulus by size"
    parameter: ClassVar[Parameter] = PARAMETERS["modulus_slope"]
    null_value: ClassVar[float] = 0.0
    kind: ClassVar[Kind] = Kind.SESSION
    circumstances: ClassVar[tuple[str, ...]] = ()
    changes: ClassVar[str] = "No shape; the apparent G_s drifts with the size."
    separated_by: ClassVar[str] = "Capsules of one size at several flow rates: their G_s is the same."

    def __call__(self, model: ForwardModel, theta: Theta, *, outline: bool = False) -> Prediction:
        """Predict at the capillary number of the capsule's own G_s."""
        stiffer = np.power(theta["size_ratio"] / self.reference, theta["modulus_slope"])
        return model({**theta, "capillary_number": theta["capillary_number"] / stiffer}, outline=outline)


# Blur of nose and rear by the motion of the capsule during the exposure


@dataclass(frozen=True)
class MotionBlur:
    """Edges detected at the outer ends of their blur, which is as long as the path during the exposure.

    Parameters
    ----------
    prior : Quantity [s]
        Of the exposure.
    """

    prior: Quantity = Quantity.log_uniform(1e-6, 1e-3, "s")
    name: ClassVar[str] = "motion blur"
    parameter: ClassVar[Parameter] = PARAMETERS["exposure"]
    null_value: ClassVar[float] = 0.0
    kind: ClassVar[Kind] = Kind.SPEED
    circumstances: ClassVar[tuple[str, ...]] = ("half_width", "capsule_velocity")
    changes: ClassVar[str] = (
        "Nose and rear are blurred and lie farther out, the more so the faster the capsule; the flanks are sharp."
    )
    separated_by: ClassVar[str] = "The width of the edges at nose and flanks, or the exposure of the camera."

    def __call__(self, model: ForwardModel, theta: Theta, *, outline: bool = False) -> Prediction:
        """Displace the edges that a model predicts."""
        path = theta["exposure"] * theta["capsule_velocity"] / theta["half_width"]
        return displaced(model(theta, outline=outline), np.zeros_like(path), 0.5 * path)


# Pixels that are higher than wide, or wider than high, where lengths are read as if they were square


@dataclass(frozen=True)
class OblongPixels:
    """Wrong scale of lengths along the flow, with a half width that is read across the flow in the same picture.

    Parameters
    ----------
    prior : Quantity
        Of the height of a pixel over its width, the flow along the rows.
    """

    prior: Quantity = Quantity(1.0, 0.02)
    name: ClassVar[str] = "oblong pixels"
    parameter: ClassVar[Parameter] = PARAMETERS["pixel_aspect"]
    null_value: ClassVar[float] = 1.0
    kind: ClassVar[Kind] = Kind.SESSION
    circumstances: ClassVar[tuple[str, ...]] = ()
    changes: ClassVar[str] = (
        "Lengths and velocity along the flow are larger by one factor; what is read across it is right."
    )
    separated_by: ClassVar[str] = "A bead or a ruled slide, of which both directions are measured on the same camera."

    def __call__(self, model: ForwardModel, theta: Theta, *, outline: bool = False) -> Prediction:
        """Stretch what a model predicts."""
        return stretched(model(theta, outline=outline), theta["pixel_aspect"])


# Pictures that are rotated: the flow is not along their rows


@dataclass(frozen=True)
class PictureRotation:
    """Angle between the flow and the rows of the picture, along which lengths and velocities are read.

    An outline is turned, which its own tilt absorbs. The extent along the rows grows, as a rim of the rear moves back;
    the length on the axis is read along a row through the nose.

    Parameters
    ----------
    prior : Quantity
        Of the angle in radians, in either sense.
    """

    prior: Quantity = Quantity.uniform(0.0, 0.1)
    name: ClassVar[str] = "rotation of the picture"
    parameter: ClassVar[Parameter] = PARAMETERS["rotation"]
    null_value: ClassVar[float] = 0.0
    kind: ClassVar[Kind] = Kind.SESSION
    circumstances: ClassVar[tuple[str, ...]] = ()
    changes: ClassVar[str] = "L_z read along the rows is too large where the rear is broad; outlines are only turned."
    separated_by: ClassVar[str] = "The walls, which are not along the rows of the picture."

    def __call__(self, model: ForwardModel, theta: Theta, *, outline: bool = False) -> Prediction:
        """Turn what a model predicts."""
        seen = model(theta, outline=True)
        assert seen.outline is not None, "asked for"
        cosine, sine = np.cos(theta["rotation"]), np.sin(theta["rotation"])
        turned = _turned(seen.outline, cosine, sine)
        longer = np.ptp(turned[..., 0], axis=1) - np.ptp(seen.outline[..., 0], axis=1)
        return replace(
            seen,
            axial_extent=seen.axial_extent + longer,
            axial_length=seen.axial_length * cosine,
            velocity_ratio=seen.velocity_ratio * cosine,
            outline=turned if outline else None,
        )


def _turned(outline: Floats, cosine: Floats, sine: Floats) -> Floats:
    """Return outlines (n, p, 2) turned by angles (n,) about the origin."""
    along, across = outline[..., 0], outline[..., 1]
    c, s = cosine[:, None], sine[:, None]
    return np.stack([c * along - s * across, s * along + c * across], axis=-1)


# Wrong pixel size, where the half width of the channel is not measured in the same picture


@dataclass(frozen=True)
class PixelScale:
    """Wrong scale of lengths and velocity, with a half width that is known independently.

    Parameters
    ----------
    prior : Quantity
        Of the relative error.
    """

    prior: Quantity = Quantity(0.0, 0.01, low=-math.inf)
    name: ClassVar[str] = "pixel scale"
    parameter: ClassVar[Parameter] = PARAMETERS["pixel_scale"]
    null_value: ClassVar[float] = 0.0
    kind: ClassVar[Kind] = Kind.SESSION
    circumstances: ClassVar[tuple[str, ...]] = ()
    changes: ClassVar[str] = (
        "Lengths over l and velocity are larger by one factor; from the shape alone it resembles a swollen channel."
    )
    separated_by: ClassVar[str] = (
        "The walls in the same picture, or a ruled slide; another flow rate distinguishes it from swelling."
    )

    def __call__(self, model: ForwardModel, theta: Theta, *, outline: bool = False) -> Prediction:
        """Scale what a model predicts."""
        factor = 1.0 + theta["pixel_scale"]
        return scaled(model(theta, outline=outline), factor, factor)


# Radial distortion by the lens: barrel or pincushion


@dataclass(frozen=True)
class RadialDistortion:
    """Magnification that grows with the square of the distance from the middle of the picture.

    The middle of the picture is taken to be the middle of the capsule on the axis of the channel, and the half width to
    be read next to it: there the wall itself is a half width away, so that this distance is right.

    Parameters
    ----------
    prior : Quantity
        Of the relative change of the magnification a half width away from the middle; negative for a barrel.
    """

    prior: Quantity = Quantity(0.0, 0.01, low=-math.inf)
    name: ClassVar[str] = "radial distortion"
    parameter: ClassVar[Parameter] = PARAMETERS["distortion"]
    null_value: ClassVar[float] = 0.0
    kind: ClassVar[Kind] = Kind.SESSION
    circumstances: ClassVar[tuple[str, ...]] = ()
    changes: ClassVar[str] = (
        "What is nearer to the middle of the picture than the walls looks too large in a barrel, what is farther too "
        "small: flanks move outwards, the ends of long capsules inwards."
    )
    separated_by: ClassVar[str] = "A ruled slide that fills the picture; the bend of straight walls."

    def __call__(self, model: ForwardModel, theta: Theta, *, outline: bool = False) -> Prediction:
        """Distort what a model predicts."""
        size = theta["distortion"][:, None, None]

        def displacement(place: Floats) -> Floats:
            return np.asarray(size * (np.sum(place**2, axis=-1, keepdims=True) - 1.0) * place)

        return warped(model(theta, outline=True), displacement, outline=outline)


# Magnification that changes along the channel, which is tilted to the focal plane


@dataclass(frozen=True)
class Taper:
    """Magnification that grows along the flow, as where one end of the channel is nearer to the lens.

    To first order in the tilt nothing else changes. A lens at a distance D from a channel that is tilted by an angle
    has a taper of tan(angle) l/D; a telecentric one has none.

    Parameters
    ----------
    prior : Quantity
        Of the relative change of the magnification along a half width.
    """

    prior: Quantity = Quantity(0.0, 0.005, low=-math.inf)
    name: ClassVar[str] = "tilt of the optical axis"
    parameter: ClassVar[Parameter] = PARAMETERS["taper"]
    null_value: ClassVar[float] = 0.0
    kind: ClassVar[Kind] = Kind.SESSION
    circumstances: ClassVar[tuple[str, ...]] = ()
    changes: ClassVar[str] = (
        "One end of the capsule looks broader and farther out, the other narrower; L_z is the same."
    )
    separated_by: ClassVar[str] = "The walls, which are not parallel in the picture."

    def __call__(self, model: ForwardModel, theta: Theta, *, outline: bool = False) -> Prediction:
        """Magnify the downstream end of what a model predicts."""
        size = theta["taper"][:, None, None]

        def displacement(place: Floats) -> Floats:
            return np.asarray(size * place[..., :1] * place)

        return warped(model(theta, outline=True), displacement, outline=outline)


# Velocities that are all wrong by one factor


@dataclass(frozen=True)
class VelocityScale(OfFlowRates):
    """Velocities larger than the true ones by one factor, by a wrong frame rate or a wrong delay between two pictures.

    Parameters
    ----------
    prior : Quantity
        Of the relative error.
    """

    prior: Quantity = Quantity(0.0, 0.05, low=-math.inf)
    name: ClassVar[str] = "velocity scale"
    parameter: ClassVar[Parameter] = PARAMETERS["velocity_scale"]
    changes: ClassVar[str] = (
        "No shape; v_o is larger than the flow rate and the size of the capsule allow, and G_s of all capsules by the "
        "same factor."
    )
    separated_by: ClassVar[str] = (
        "The frame rate by a lamp of known period, or the velocity of a bead on a moving stage."
    )

    def __call__(self, model: ForwardModel, theta: Theta, *, outline: bool = False) -> Prediction:
        """Scale the velocities that a model predicts."""
        factor = self.factor(theta)
        return scaled(model(theta, outline=outline), np.ones_like(factor), factor)


# Wrong viscosity, which no outline shows


@dataclass(frozen=True)
class ViscosityError:
    """Viscosity larger than assumed; ``capillary_number`` is then that of the assumed viscosity.

    All moduli are wrong by one factor, which shapes and velocities do not show; the catalogue lists it so that
    tables state this.

    Parameters
    ----------
    prior : Quantity
        Of the relative error, in addition to that of the experiment.
    """

    prior: Quantity = Quantity(0.0, 0.1, low=-math.inf)
    name: ClassVar[str] = "viscosity"
    parameter: ClassVar[Parameter] = PARAMETERS["viscosity_error"]
    null_value: ClassVar[float] = 0.0
    kind: ClassVar[Kind] = Kind.SESSION
    circumstances: ClassVar[tuple[str, ...]] = ()
    changes: ClassVar[str] = "Nothing visible; G_s of all capsules is wrong by one factor."
    unseen_because: ClassVar[str] = "Shapes depend on viscosity and G_s through Ca alone, which is free."
    separated_by: ClassVar[str] = "A viscometer at the temperature of the channel."

    def __call__(self, model: ForwardModel, theta: Theta, *, outline: bool = False) -> Prediction:
        """Predict at the capillary number of the true viscosity."""
        factor = 1.0 + theta["viscosity_error"]
        return model({**theta, "capillary_number": theta["capillary_number"] * factor}, outline=outline)
