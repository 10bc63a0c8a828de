"""Capsules of a batch that is yet to be filmed, at several flow rates, as they would be measured without noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from capsbayes.arrays import Floats, Integers
from capsbayes.errors import InputError
from capsbayes.experiment import AREAS, Experiment
from capsbayes.infer.many.one_membrane.conditional import COMMON, MODULUS, SIZE, Capsules, Start
from capsbayes.infer.many.one_membrane.identify_membrane import ONE_CAPSULE, capsules_of
from capsbayes.infer.many.one_membrane.numbers import Lengths
from capsbayes.infer.many.one_membrane.search import step_of_all
from capsbayes.infer.many.one_membrane.unknowns import Unknowns
from capsbayes.plan.expectation import Expectation
from capsbayes.plan.expected_membrane import ExpectedMembrane
from capsbayes.plan.lab_errors import LabErrors
from capsbayes.plan.widths import noise_lattice
from capsbayes.surrogate import MembraneSurrogate

_MOST = 12  # different capsules of one flow rate
EVERY = 4
"""Vertices of a predicted outline for one that is measured."""


@dataclass(frozen=True, eq=False)
class PlannedBatch:
    """Capsules that are expected at some flow rates, of which some are to be filmed."""

    capsules: Capsules  # all of them, without the model's own error
    own: Floats  # (n, 2): ln Ca and a/l
    flow: Integers  # (n,): number of the flow rate
    means: tuple[float, float]  # of ln(G_s / (N/m)) and of a/l
    unknowns: Unknowns  # with the spreads of the population that is expected
    scores: Floats  # (f,): normal scores of the membrane that is expected

    @classmethod
    def of(
        cls,
        expectation: Expectation,
        velocities: Floats,
        errors: LabErrors,
        experiment: Experiment,
        model: MembraneSurrogate,
        unknowns: Unknowns,
        scores: Floats,
        *,
        same_capsule: bool = False,
        scale_error: float = 0.0,
    ) -> PlannedBatch:
        """Set up the capsules of a population at mean velocities (k,) [m/s]; omit those without a shape."""
        # The spreads of G_s and a are those from capsule to capsule; `scale_error` is relative and common to all
        # lengths.
        centre, spreads = expectation.centre, spreads_of(expectation, same_capsule=same_capsule)
        lattice = noise_lattice(1 if same_capsule else _MOST)
        log_ca = np.log([centre.capillary_number(velocity)[0] for velocity in velocities])
        middle = np.stack([log_ca, np.full(len(velocities), centre.size_ratio[0])], axis=1)
        means = float(np.log(centre.surface_shear_modulus[0])), float(centre.size_ratio[0])
        own = (middle[:, None] + np.array([-spreads[0], spreads[1]]) * lattice).reshape(-1, 2)
        flow = np.repeat(np.arange(len(velocities)), len(lattice))
        known = Unknowns(unknowns.coordinates, unknowns.known, spreads)
        shape_model = Lengths(model, experiment.half_width.value)
        theta = shape_model.theta(known.membranes(scores[None]), own[None])
        seen = model(theta, outline=errors.outline is not None)
        rows = np.flatnonzero(seen.inside)
        if not len(rows):
            expected = f"velocities at which {model.name} has a shape of such capsules"
            got = ", ".join(f"{speed:.3g} m/s" for speed in velocities)
            raise InputError("flow_design", "velocities", expected, got)
        area = AREAS[experiment.cross_section] * experiment.half_width.value**2
        measurements = [
            errors.measured(
                seen.values[row, :2],
                float(velocities[flow[row]] * seen.velocity_ratio[row]),
                None if seen.outline is None else seen.outline[row, ::EVERY],
                float(velocities[flow[row]] * area),
            )
            for row in rows
        ]
        capsules = capsules_of(measurements, experiment, model, scale_error=scale_error)
        return cls(capsules, own[rows], flow[rows], means, known, scores)

    def told_by(self, flows: Sequence[int], count: int) -> ExpectedMembrane:
        """Return what so many capsules tell, filmed in equal shares at some of the flow rates."""
        shares = np.array_split(np.arange(max(count, len(flows))), len(flows))
        rows = np.concatenate([self._rows(k, len(share)) for k, share in zip(flows, shares, strict=True)])
        own, point = self.own[rows], self.scores[None]
        common = np.zeros((1, COMMON))
        common[0, [MODULUS, SIZE]] = self.means
        some = replace(self.capsules, batch=self.capsules.batch.taken(rows))
        known = some.with_model_error(self.unknowns.membranes(point), own)
        values = Start(own[None], common)
        step = step_of_all(known, self.unknowns, point, values)
        return ExpectedMembrane(known, self.unknowns, self.scores, values, step.covariance[0])

    def _rows(self, flow: int, count: int) -> Integers:
        """Return rows of capsules at a flow rate, spread over the population, some several times if they are few."""
        there = np.flatnonzero(self.flow == flow)
        return there[(2 * np.arange(count) + 1) * len(there) // (2 * count)]


def spreads_of(expectation: Expectation, *, same_capsule: bool) -> tuple[float, float]:
    """Return the spreads of ln G_s and of a/l among the capsules that are expected."""
    if same_capsule:
        return ONE_CAPSULE
    modulus, radius = expectation.surface_shear_modulus, expectation.capsule_radius
    of_size = radius.sd / expectation.half_width.value
    return max(modulus.sd / modulus.mean, ONE_CAPSULE[0]), max(of_size, ONE_CAPSULE[1])
