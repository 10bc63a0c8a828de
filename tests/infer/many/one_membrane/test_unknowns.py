"""What is unknown of a batch beside its capsules."""

import numpy as np

from capsbayes.infer.conditional import Unknowns


def test_spreads_do_not_vanish():
    unknowns = Unknowns.of((), {}, (None, None))
    spreads = unknowns.spreads_at(np.log([[0.15, 0.06], [1e-9, 1e-12]]))
    np.testing.assert_allclose(spreads.modulus, [0.15, 1e-4])
    np.testing.assert_allclose(spreads.size, [0.06, 1e-4])
