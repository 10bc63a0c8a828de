"""Every membrane law, at several values of its parameter."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from capsbayes.evidence.verification.references import MODULI
from capsbayes.evidence.verification.row import Reference, Row, Target
from capsbayes.evidence.verification.section import Results, Section, Values
from capsbayes.physics.membrane import law_named
from capsbayes.testing import check_law

__all__ = ["section"]

_STRAIN = 1e-4


def section() -> Section:
    """Moduli at small strain, after every promise of a law was checked."""
    return Section(
        "membrane-laws",
        "Membrane laws",
        "Each law keeps the promises of `capsbayes.testing.check_law`, or has no row of numbers: true derivatives of "
        "its energy, tensions, isotropy. The moduli over G_s are slopes of its tensions at small strain.",
        {str(law): partial(_moduli, str(law)) for law in MODULI.numbers},
        _rows,
    )


def _moduli(name: str) -> Values:
    law = law_named(name)
    check_law(law)
    strains = _STRAIN * np.array([[1.0, 1.0], [1.0, -1.0]])
    tensions = law.principal_tensions(1.0 + strains) - law.principal_tensions(1.0 - strains)
    dilation, shear = (float(slope) for slope in tensions[:, 0] / (4.0 * _STRAIN))
    return {"area_dilation_modulus": dilation, "shear_modulus": shear}


def _rows(results: Results) -> Iterator[Row]:
    for law in MODULI.numbers:
        dilation, shear = (results.value(str(law), f"{name}_modulus") for name in ("area_dilation", "shear"))
        yield Row(f"{law}: K_s", dilation, MODULI.at(law, "area_dilation_modulus"), Target("absolute", 1e-6))
        yield Row(f"{law}: G_s", shear, Reference(1.0, "the scale"), Target("absolute", 1e-6))
