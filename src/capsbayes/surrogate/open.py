"""Shipped and own databases opened as forward models."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from capsbayes.database import NO_EFFECT, Database
from capsbayes.errors import InputError
from capsbayes.measurement import MID_PLANE, check_view
from capsbayes.membrane_database import FREE_PARAMETERS, NULL_VALUES, PLAIN_LAW, MembraneDatabase
from capsbayes.model import ForwardModel
from capsbayes.surrogate.corrected_membrane import CorrectedMembrane
from capsbayes.surrogate.effect import SLICE_CELLS, EffectSurrogate, check_values
from capsbayes.surrogate.membrane import MembraneSurrogate
from capsbayes.surrogate.plane import PlaneSurrogate

_PLAIN = dict(zip(FREE_PARAMETERS, NULL_VALUES, strict=True)) | {"law": PLAIN_LAW}
_PLAIN |= {"rest_aspect": 1.0, "corner_radius": 0.0, "section_aspect": 1.0}


class Surrogate(PlaneSurrogate):
    """Forward model (Ca, a/l) -> (L_z, L_a, v_o/U, Lambda, outline) over a database.

    Parameters
    ----------
    database : Database
        Steady shapes, in columns of equal a/l.
    cells : tuple of int
        Number of cells of its tables along sqrt(Ca) and a/l.
    view : str
        Outlines that it predicts: ``"mid-plane"``, in the plane x = 0, or ``"silhouette"``, as in a photograph.

    Attributes
    ----------
    domain : DomainOfExistence
        Where it has an answer.
    branches : tuple of BranchSurrogate
        One for each branch of steady shapes.

    Examples
    --------
    >>> import numpy as np
    >>> model = Surrogate.open("square-neo-hookean")
    >>> capsule = model.at(capillary_number=0.082, size_ratio=0.96)
    >>> [round(float(value), 2) for value in capsule.values[0]]
    [2.15, 1.82, 1.3]
    >>> int(model({"capillary_number": np.array([0.05, 0.5]), "size_ratio": np.array([0.9, 0.9])}).inside.sum())
    1
    """

    @classmethod
    def open(cls, source: str | Path, *, view: str = MID_PLANE) -> Surrogate | EffectSurrogate:
        """Make a surrogate of a shipped database (by name) or of a file (by path, with its ending .nc).

        The base of an effect database is the shipped one of its cross-section and law, if there is one.

        Parameters
        ----------
        source : str or path
        view : str
            View of the outlines that it predicts: ``"mid-plane"`` or ``"silhouette"``.

        Raises
        ------
        DatabaseError
            If the database cannot be read.
        InputError
            On an unknown view.
        """
        view = check_view(view, "Surrogate", "view")
        database = Database.open(source)
        base = database.plain_relative() if database.effect != NO_EFFECT else None
        return cls.from_database(database, base=base, view=view)

    @classmethod
    def from_database(
        cls, database: Database, *, base: Database | Surrogate | None = None, view: str | None = None
    ) -> Surrogate | EffectSurrogate:
        """Make a surrogate; that of an effect database has the effect as one more coordinate.

        Parameters
        ----------
        database : Database
        base : Database or Surrogate, optional
            For an effect database, a plain one of a finer mesh at the null value; by default the null slice itself.
        view : str, optional
            View of the outlines: ``"mid-plane"`` or ``"silhouette"``; by default that of the base, or the mid-plane.

        Raises
        ------
        DatabaseError
            If an effect database has too few values or not the null value, or if the base is of another
            cross-section.
        InputError
            On an unknown view, or one that is not that of the base.
        """
        of_base = base.view if isinstance(base, Surrogate) else MID_PLANE
        view = of_base if view is None else check_view(view, "Surrogate", "view")
        if database.effect == NO_EFFECT:
            return cls(database, view=view)
        check_values(database)
        if isinstance(base, Surrogate) and base.view != view:
            raise InputError("Surrogate", "view", f'"{base.view}", that of the base', repr(view))
        slices = {value: cls(database.at_value(value), SLICE_CELLS, view) for value in database.values}
        plain = cls(base, view=view) if isinstance(base, Database) else base or slices[database.null_value]
        return EffectSurrogate(database, tuple(slices.values()), plain)

    def joined(self, effect_database: str) -> EffectSurrogate:
        return joint_surrogate(effect_database, self, self.view)

    def with_membrane(self) -> CorrectedMembrane | None:
        return corrected_membrane(self)


@lru_cache(maxsize=16)
def joint_surrogate(effect_database: str, base: Surrogate | None, view: str) -> EffectSurrogate:
    """Return the surrogate of a shipped effect database, over a base or the shipped one; kept for later calls."""
    if base is None:
        joint = Surrogate.open(effect_database, view=view)
    else:
        joint = Surrogate.from_database(Database.open(effect_database), base=base, view=view)
    assert isinstance(joint, EffectSurrogate), "an effect database"
    return joint


@lru_cache(maxsize=4)
def corrected_membrane(base: Surrogate) -> CorrectedMembrane | None:
    """Return the surrogate over the membrane on top of a plain one, None if there is none; kept for later calls."""
    settings = base.database.settings
    plain = all(settings[name] == value for name, value in _PLAIN.items() if name in settings)
    if not plain or base.cross_section not in MembraneDatabase.shipped():
        return None
    return CorrectedMembrane(base, MembraneSurrogate.open(str(base.cross_section), view=base.view))


@lru_cache(maxsize=4)
def plain_membrane(cross_section: str, view: str) -> CorrectedMembrane:
    """Return the surrogate over the membrane on top of the shipped plain one; kept for later calls."""
    plain = Surrogate.open(f"{cross_section}-{PLAIN_LAW.lower()}", view=view)
    made = plain.with_membrane() if isinstance(plain, Surrogate) else None
    assert made is not None, "shipped for this cross-section"
    return made


def model_named(name: str, view: str = MID_PLANE) -> ForwardModel:
    """Open the model of a name, as ``"square-neo-hookean"`` or ``"square-membrane"``, or that of a database's file."""
    if name.endswith("-membrane"):
        return MembraneSurrogate.open(name.removesuffix("-membrane"), view=view)
    return Surrogate.open(name, view=view)
