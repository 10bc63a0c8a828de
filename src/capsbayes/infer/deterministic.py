"""Deterministic identification of the same capsule by the procedure of the paper: one number each, no errors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field

from capsbayes.experiment import capsule_radius, surface_shear_modulus
from capsbayes.infer.inputs import Inputs
from capsbayes.measurement import Measurement
from capsbayes.model import ForwardModel


@dataclass(frozen=True)
class DeterministicAnswer:
    """Quantities by diffuse approximation, SI; named as in `capsbayes.parameters`.

    The mean velocity is missing where mu U is given as one quantity. `assumed` holds the null value of a further
    coordinate of the model, which the procedure does not know.
    """

    surface_shear_modulus: float
    capsule_radius: float
    mean_velocity: float | None
    capillary_number: float
    size_ratio: float
    velocity_ratio: float
    assumed: Mapping[str, float] = field(default_factory=dict)

    def as_dict(self) -> dict[str, float]:
        """Return the quantities by name, those assumed included."""
        quantities = asdict(self)
        quantities |= quantities.pop("assumed")
        return {name: value for name, value in quantities.items() if value is not None}


def deterministic_answer(measurement: Measurement, model: ForwardModel, inputs: Inputs) -> DeterministicAnswer | None:
    """Identify with the paper's procedure on the model's database.

    Returns
    -------
    DeterministicAnswer or None
        None where the procedure does not apply: L_a missing, or a model without database.
    """
    database = model.database
    if database is None or measurement.axial_length is None:
        return None
    from capsbayes.surrogate import inverse

    scale = 1.0 if measurement.over_half_width else inputs.half_width.value
    found = inverse(database)(
        axial_extent=measurement.axial_extent / scale, axial_length=measurement.axial_length / scale
    )
    flow = inputs.mean_velocity(found.velocity_ratio)
    modulus = surface_shear_modulus(
        viscosity=inputs.viscosity.value, mean_velocity=flow, capillary_number=found.capillary_number
    )
    radius = capsule_radius(size_ratio=found.size_ratio, half_width=inputs.half_width.value)
    assumed = {name: ends.null_value for name, ends in model.coordinates.items()}
    shape = found.capillary_number, found.size_ratio, found.velocity_ratio
    known = None if inputs.viscous_tension else float(flow)
    return DeterministicAnswer(float(modulus), float(radius), known, *shape, assumed)
