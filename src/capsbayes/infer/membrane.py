"""What is known of a membrane: its law, moduli, inflation and thickness, as a model and the priors of what is left."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from types import MappingProxyType

from capsbayes.errors import InputError
from capsbayes.files.input_file import InputFile
from capsbayes.infer.prior import THICKNESS, Prior
from capsbayes.model import ForwardModel
from capsbayes.parameters import PARAMETERS
from capsbayes.quantity import Given, Quantity

UNKNOWN = "unknown"

LAWS: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {
        UNKNOWN: {},
        "neo-Hookean": {"area_dilation_modulus": 3.0, "strain_hardening": 0.0},
        "Blatz-Ko": {"strain_hardening": 0.0},
        "Skalak": {"strain_hardening": 1.0},
    }
)
"""Values that a law has of K and h, see `capsbayes.physics.membrane.GeneralLaw`."""


@dataclass(frozen=True)
class Membrane:
    """What is known of the membrane of a capsule.

    Each number is known, uncertain, or unknown: ``3.0``, ``"1.5 +/- 0.3"`` or ``"1 .. 2"``, None or ``"unknown"``. What
    is known is fixed in the model, what is uncertain has this prior, what is unknown the default one.

    Parameters
    ----------
    law : str
        One of `LAWS`, in any case.
    area_dilation_modulus : Quantity, optional [G_s]
        Area dilation modulus K = K_s / G_s.
    strain_hardening : Quantity, optional [-]
        Share h of Skalak's energy.
    pre_inflation : Quantity, optional [-]
        Pre-inflation alpha, the radius added by inner pressure over that without.
    bending : Quantity, optional [G_s a^2]
        Bending modulus B.
    membrane_thickness : Quantity, optional [m]
        Thickness t, which determines B, in place of B.
    hardening : Quantity, optional [-]
        C of Skalak's law, in place of K = 1 + 2 C.
    source : str
        File or argument in which it is stated, for error messages.

    Raises
    ------
    InputError
        On an unknown law, a value that cannot be read, or two statements of one number.

    Examples
    --------
    >>> from capsbayes.surrogate import MembraneSurrogate
    >>> model, prior = Membrane("Skalak", hardening=1.0).applied(MembraneSurrogate.open("square"), Prior())
    >>> model.name
    'square-membrane at strain_hardening = 1, area_dilation_modulus = 3'
    >>> list(model.coordinates), dict(prior.coordinates)
    (['pre_inflation', 'bending'], {})
    """

    law: str = UNKNOWN
    area_dilation_modulus: Given | None = None
    strain_hardening: Given | None = None
    pre_inflation: Given | None = None
    bending: Given | None = None
    membrane_thickness: Given | None = None
    hardening: Given | None = None
    source: str = "membrane"

    def __post_init__(self) -> None:
        known = {law.lower(): law for law in LAWS}
        if not isinstance(self.law, str) or self.law.lower() not in known:
            raise InputError(self.source, "law", f"one of {', '.join(LAWS)}", repr(self.law))
        object.__setattr__(self, "law", known[self.law.lower()])
        for name in KEYS:
            object.__setattr__(self, name, self._read(name))
        self._check()

    @classmethod
    def read(cls, path: str | Path) -> Membrane | None:
        """Read the table ``[membrane]`` of a measurement's file, whose keys are the parameters; None without one.

        Raises
        ------
        InputError
            Naming file, key, what was expected and what was found.
        """
        file = InputFile.read(path)
        if "membrane" not in file.content:
            return None
        return cls(**file.table("membrane", optional=("law", *KEYS)), source=f"{path}: membrane")

    def with_texts(self, texts: Mapping[str, str], *, where: str) -> Membrane:
        """Return a copy in which parameters are replaced, given by name in text form."""
        return replace(self, **dict(texts), source=where)

    def applied(self, model: ForwardModel, prior: Prior) -> tuple[ForwardModel, Prior]:
        """Fix what is known in a model, and add what is uncertain to a prior.

        Parameters
        ----------
        model : ForwardModel
            With these parameters as coordinates, as `capsbayes.surrogate.MembraneSurrogate`.
        prior : Prior

        Raises
        ------
        InputError
            If the model has no such coordinate, a known value lies beyond its range, or the prior states one of them
            already.
        """
        stated = self._stated()
        fixed = {name: one.value for name, one in stated.items() if one.known and name != THICKNESS}
        for name, value in fixed.items():
            ends = model.coordinates.get(name)
            if ends is None or not ends.low <= value <= ends.high:
                expected = (
                    "nothing, as the model does not have it" if ends is None else f"{ends.low:g} to {ends.high:g}"
                )
                raise InputError(self.source, name, expected, f"{value:g}")
        for name in stated:
            if name in prior.coordinates:
                raise InputError(self.source, name, "one statement of it", f"{stated[name]}, and a prior")
        uncertain = {name: one for name, one in stated.items() if name not in fixed}
        believed = replace(prior, coordinates={**prior.coordinates, **uncertain})
        return (model.fixed(**fixed) if fixed else model), believed

    def _read(self, name: str) -> Quantity | None:
        given = getattr(self, name)
        if given is None or given == UNKNOWN:
            return None
        units = (PARAMETERS[name].si,)
        try:
            return Quantity.of(given, name, where=self.source, units=units, signed=name != THICKNESS)
        except InputError as error:
            example = "0.6 +/- 0.2 um" if name == THICKNESS else "1.5 +/- 0.3"
            expected = f'a number, a text as "{example}", or "{UNKNOWN}"'
            raise InputError(self.source, name, expected, error.got, error.advice) from None

    def _check(self) -> None:
        """Refuse two statements of one number."""
        of_law = LAWS[self.law]
        for name in of_law:
            if getattr(self, name) is not None:
                raise InputError(self.source, name, f"nothing, as {self.law} states it", str(getattr(self, name)))
        if self.hardening is not None and (self.law != "Skalak" or self.area_dilation_modulus is not None):
            expected = "nothing but with the law Skalak, whose area_dilation_modulus K is 1 + 2 C then"
            raise InputError(self.source, "hardening", expected, str(self.hardening))
        if self.bending is not None and self.membrane_thickness is not None:
            raise InputError(self.source, f"bending, {THICKNESS}", "one of the two, as B = (t/a)^2 / 3", "both")

    def _stated(self) -> dict[str, Quantity]:
        """Return what is known or uncertain, by the names of coordinates and that of the thickness."""
        found = {name: Quantity(value) for name, value in LAWS[self.law].items()}
        for name in KEYS:
            if name != "hardening" and getattr(self, name) is not None:
                found[name] = getattr(self, name)
        if self.hardening is not None:
            found["area_dilation_modulus"] = self._of_hardening(self.hardening)
        return found

    def _of_hardening(self, hardening: Quantity) -> Quantity:
        """Return K = 1 + 2 C."""
        if hardening.shape == "uniform":
            return Quantity.uniform(1.0 + 2.0 * hardening.low, 1.0 + 2.0 * hardening.high)
        if hardening.shape != "normal":
            expected = 'a number, a range as "0.5 .. 1.5" or a value with its error as "1.0 +/- 0.3"'
            raise InputError(self.source, "hardening", expected, str(hardening))
        return Quantity(1.0 + 2.0 * hardening.value, 2.0 * hardening.error, low=1.0 + 2.0 * hardening.low)


KEYS = tuple(field.name for field in fields(Membrane) if field.name not in ("law", "source"))
"""Names of the numbers of a membrane."""


def refuse_membrane(path: str | Path, where: str) -> None:
    """Refuse a measurement's file with a table ``[membrane]`` where the membrane is that of a database.

    Raises
    ------
    InputError
    """
    if "membrane" in InputFile.read(path).content:
        advice = "remove it, or use capsbayes identify"
        raise InputError(str(path), "membrane", f"no such table in a capsule of {where}", "one", advice)
