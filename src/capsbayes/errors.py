"""Errors, named for their cause, with their evidence as attributes."""

from __future__ import annotations

from typing import Any


class CapsbayesError(Exception):
    """Base of every error a user can cause; the command line prints it as one line, exit status 2."""

    def __reduce__(self) -> tuple[Any, ...]:
        return _restored, (type(self), self.args, self.__dict__)  # by which worker processes send it


class InputError(CapsbayesError):
    """A value, key or file that cannot be used.

    Parameters
    ----------
    where : str
        File, argument or object that holds the mistake.
    key : str
        The key, column or parameter at fault (may be empty).
    expected, got : str
        The right form of the value, and the value given.
    advice : str, optional
        Remedy.
    """

    def __init__(self, where: str, key: str, expected: str, got: str, advice: str = "") -> None:
        self.where, self.key, self.expected, self.got, self.advice = where, key, expected, got, advice
        place = f"{where}: {key}" if key else where
        tail = f"; {advice}" if advice else ""
        super().__init__(" ".join(f"{place}: expected {expected}, got {got}{tail}".splitlines()))


class NoRoomError(InputError):
    """A disk that is full."""


class CutOffError(InputError):
    """A file that holds less than it says."""


class NoShapeError(InputError):
    """A measurement that lies far from every shape of the model: `distance` standard deviations from the nearest."""

    distance = float("nan")


class DatabaseError(CapsbayesError):
    """A database file that is missing, damaged or not of the asked kind."""


class OutsideDatabaseError(CapsbayesError):
    """A point outside the domain of existence that the database covers.

    Parameters
    ----------
    capillary_number, size_ratio : float
        The point asked for [-].
    reason : str
        Which side of the domain it lies on.
    """

    def __init__(self, capillary_number: float, size_ratio: float, reason: str) -> None:
        self.capillary_number, self.size_ratio = capillary_number, size_ratio
        super().__init__(f"Ca = {capillary_number:.4g}, a/l = {size_ratio:.4g} is outside the database: {reason}")


class BrokenPromiseError(CapsbayesError, AssertionError):
    """A law, model or effect that does not keep one of the promises of its kind.

    Parameters
    ----------
    subject : str
        Name of the law, model or effect.
    promise : str
        The promise, as a sentence that should be true.
    found : str
        The result that contradicts it, and its place.
    """

    def __init__(self, subject: str, promise: str, found: str) -> None:
        self.subject, self.promise, self.found = subject, promise, found
        super().__init__(f"{subject} breaks its promise: {promise}; found {found}")


def _restored(kind: type[CapsbayesError], arguments: tuple[Any, ...], evidence: dict[str, Any]) -> CapsbayesError:
    error = kind.__new__(kind, *arguments)
    error.__dict__.update(evidence)
    return error
