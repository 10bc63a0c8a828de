"""Shapes that are linear in all unknowns, and a batch of capsules that have them."""

from dataclasses import dataclass

import numpy as np

from capsbayes.infer.conditional import Batch, ShapeModel, Shapes, ShapeSlopes

ALONG = np.array([[0.30, 1.7], [-0.25, 1.9], [0.1, -0.4]])  # of three numbers along ln Ca and a/l
OF_MEMBRANE = np.array([0.4, 0.1, -0.3])
RATIO = 0.2  # ln(v_o/U)


@dataclass(frozen=True, eq=False)
class Linear(ShapeModel):
    """Three numbers that are linear in ln Ca, a/l and one parameter of the membrane, everywhere."""

    model: None = None
    half_width: float = 25e-6
    error: float = 0.0

    def __call__(self, theta, *, errors=True):
        place = np.stack([np.log(theta["capillary_number"]), theta["size_ratio"]], axis=1)
        numbers = place @ ALONG.T + theta["pre_inflation"][:, None] * OF_MEMBRANE
        n = len(numbers)
        return Shapes(numbers, np.tile(self.error**2 * np.eye(3), (n, 1, 1)), np.full(n, RATIO), np.zeros(n))

    def with_slopes(self, theta, moved):
        shapes = self(theta)
        ahead = [self(other) for other in moved]
        numbers = np.array([other.numbers - shapes.numbers for other in ahead])
        return shapes, ShapeSlopes(numbers, np.array([other.log_ratio - shapes.log_ratio for other in ahead]))

    @property
    def bounds(self):
        return (0.005, 0.3), (0.6, 1.2)

    def places(self, membranes, own):
        return membranes["pre_inflation"][:, None] / 0.05

    def contains(self, membranes, own):
        return np.ones(own.shape[:2], dtype=bool)

    def theta(self, membranes, own):
        theta = super().theta(membranes, own[..., :2])
        if own.shape[2] > 2:  # linear, where the model has an exponential function
            theta["pre_inflation"] = theta["pre_inflation"] * (1.0 + own[..., 2].ravel())
        return theta


def linear_batch():
    """Return seven capsules of whose shapes four numbers are measured."""
    rng = np.random.default_rng(0)
    n, q = 7, 4
    rows = rng.normal(size=(n, q, 3)) / 0.05
    truth = np.stack([np.log(0.05) + 0.3 * rng.normal(size=n), 0.9 + 0.05 * rng.normal(size=n)], axis=1)
    numbers = truth @ ALONG.T + 0.05 * OF_MEMBRANE
    target = np.einsum("nqk,nk->nq", rows, numbers) + rng.normal(size=(n, q))
    velocity = 5e-3 * np.exp(0.2 * rng.normal(size=n))
    return Batch(
        rows=rows,
        target=target,
        scale=rng.normal(size=(n, q)),
        left=np.zeros(n),
        known=np.full(n, q),
        log_velocity=np.log(velocity),
        velocity_error=np.full(n, 0.02),
        log_mean_velocity=np.full(n, np.nan),
        group=np.array([0, 0, 0, 1, 1, 1, 1]),
        scale_error=0.5,
        rate_error=0.0,
    )
