"""check_effect lets good effects pass and says which promise a bad one breaks."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy import stats

from capsbayes import Surrogate
from capsbayes.effects import Halo
from capsbayes.errors import BrokenPromiseError
from capsbayes.quantity import Quantity
from capsbayes.testing import check_effect


@dataclass(frozen=True)
class Wordless(Halo):
    changes = ""


@dataclass(frozen=True)
class Restless(Halo):
    null_value = 1e-7


@dataclass(frozen=True)
class Idle(Halo):
    def __call__(self, model, theta, *, outline=False):
        return model(theta, outline=outline)


@dataclass(frozen=True)
class Sociable(Halo):
    def __call__(self, model, theta, *, outline=False):
        seen = super().__call__(model, theta, outline=outline)
        first = np.where(theta["halo"] != 0.0, seen.axial_extent[0], seen.axial_extent)
        return replace(seen, axial_extent=first)


@dataclass(frozen=True)
class Meddling(Halo):
    def __call__(self, model, theta, *, outline=False):
        seen = super().__call__(model, theta, outline=outline)
        theta["halo"][:] *= 1.1
        return seen


@dataclass(frozen=True)
class Boundless(Halo):
    def __call__(self, model, theta, *, outline=False):
        seen = super().__call__(model, theta, outline=outline)
        return replace(seen, inside=np.ones_like(seen.inside))


@dataclass(frozen=True)
class LengthsOnly(Halo):
    def __call__(self, model, theta, *, outline=False):
        return replace(super().__call__(model, theta, outline=outline), outline=model(theta, outline=outline).outline)


@pytest.mark.parametrize(
    ("effect", "promise"),
    [
        (Wordless(), "it has a name, sentences"),
        (Halo(stats.norm(0.0, 5e-7)), "prior is a rv_continuous_frozen, not a Quantity"),
        (Restless(), "at its null value it changes nothing"),
        (Idle(), "at a typical size it changes something"),
        (Sociable(), "it treats each capsule of a batch by itself"),
        (Meddling(), "it changes the arrays that it is given"),
        (Boundless(), "outside the domain of the model it has no answer"),
        (LengthsOnly(Quantity(0.0, 5e-6, "m", low=-np.inf)), "it moves the outline as it moves the lengths"),
    ],
    ids=lambda one: type(one).__name__,
)
def test_the_broken_promise_is_named(effect, promise):
    with pytest.raises(BrokenPromiseError, match=promise):
        check_effect(effect, Surrogate.open("square-neo-hookean"))
