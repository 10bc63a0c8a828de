"""Paths of a command: what it reads and writes is declared with its options, and checked before any work starts."""

from __future__ import annotations

import functools
import inspect
import math
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from capsbayes.errors import InputError
from capsbayes.files.output_file import check_replaceable, guarded, is_ours, refusing

_LARGEST = 2**63 - 1  # integer that a NetCDF file holds


@dataclass(frozen=True)
class Reads:
    """Declaration of a file or folder that a command reads; `updated` if the command writes it back with more in it."""

    updated: bool = False


@dataclass(frozen=True)
class Writes:
    """Declaration of what a command writes.

    Parameters
    ----------
    *suffixes : str
        Endings that the name of a file may have; none for a folder.
    next_to : tuple of str
        What is written next to it, as formats of its ``{name}`` and ``{stem}``, globs among them. One that ends in
        ``/`` is a folder of its own.
    within : function of the command's values, or tuple of str
        What is written into the folder; globs.
    """

    suffixes: tuple[str, ...]
    next_to: tuple[str, ...] = ()
    within: Callable[[Mapping[str, Any]], tuple[str, ...]] | tuple[str, ...] = ()

    def __init__(self, *suffixes: str, next_to: tuple[str, ...] = (), within: Any = ()) -> None:
        object.__setattr__(self, "suffixes", suffixes)
        object.__setattr__(self, "next_to", next_to)
        object.__setattr__(self, "within", within)

    def check(self, option: str, path: Path) -> None:
        """Refuse a path that cannot be written, or is of another kind."""
        if self.suffixes:
            if path.suffix not in self.suffixes:
                expected = f"a file name that ends in {' or '.join(self.suffixes)}"
                raise InputError(option, "", expected, repr(str(path)))
            if path.is_dir():
                raise InputError(option, "", "a file", f"the folder {path}")
            if not path.parent.is_dir():
                raise InputError(option, "", "a folder that exists", repr(str(path.parent)))
        elif path.exists() and not path.is_dir():
            raise InputError(option, "", "a folder", f"the file {path}")
        for place in path.absolute().parents:
            if place.exists() and not place.is_dir():
                raise InputError(option, "", "a folder", f"the file {place}")
        _check_writable(path)

    def outputs(self, path: Path, values: Mapping[str, Any]) -> Iterator[tuple[Path, bool]]:
        """Yield each path that is written and exists or has a name known before, and True for a folder."""
        yield path, not self.suffixes
        for form in self.next_to:
            place = path.with_name(form.format(name=path.name, stem=path.stem).rstrip("/"))
            found = path.parent.glob(place.name) if "*" in form else [place]
            yield from ((file, form.endswith("/")) for file in found)
        for form in self.within(values) if callable(self.within) else self.within:
            yield from ((file, False) for file in (path.glob(form) if "*" in form else [path / form]))


Overwrite = Annotated[
    bool,
    typer.Option("--overwrite", help="Replace files that capsbayes did not write, or that were changed since."),
]


def checked(command: Callable[..., None]) -> Callable[..., None]:
    """Check the paths and numbers of a command before it runs, and let it replace nothing that must stay.

    A command that writes gets the option ``--overwrite``.
    """
    signature = inspect.signature(command, eval_str=True)
    declared = {name: _declared(parameter) for name, parameter in signature.parameters.items()}
    options = {name: option_name(parameter) for name, parameter in signature.parameters.items()}
    writes = any(isinstance(about, Writes) for about in declared.values())

    @functools.wraps(command)
    def run(**given: Any) -> None:
        overwrite = given.pop("overwrite", False)
        for name, value in given.items():
            _check_number(options[name], value)
        paths = {name: Path(given[name]) for name, about in declared.items() if about and given[name] is not None}
        reads = {name: path for name, path in paths.items() if isinstance(declared[name], Reads) and _exists(path)}
        updated = [path for name, path in reads.items() if declared[name].updated]
        with guarded(set(reads.values()) - set(updated), updated=updated, overwrite=overwrite):
            for path in updated:
                _check_writable(path)
            made: dict[Path, str] = {}
            for name, path in paths.items():
                if isinstance(about := declared[name], Writes):
                    about.check(options[name], path)
                    _check_outputs(options[name], about.outputs(path, given), made, list(reads.values()))
            command(**given)

    own = [inspect.Parameter("overwrite", inspect.Parameter.KEYWORD_ONLY, default=False, annotation=Overwrite)]
    parameters = [parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY) for parameter in signature.parameters.values()]
    run.__signature__ = signature.replace(parameters=parameters + own * writes)  # type: ignore[attr-defined]
    return run


def _declared(parameter: inspect.Parameter) -> Any:
    """Return how a parameter is declared: as what is read, as what is written, or as neither."""
    metadata = getattr(parameter.annotation, "__metadata__", ())
    return next((about for about in metadata if isinstance(about, Reads | Writes)), None)


def option_name(parameter: inspect.Parameter) -> str:
    """Return the name of an option as it is typed."""
    for about in getattr(parameter.annotation, "__metadata__", ()):
        for typed in (getattr(about, "default", None), *(getattr(about, "param_decls", None) or ())):
            if isinstance(typed, str) and typed.startswith("--"):
                return typed
    return f"--{parameter.name.replace('_', '-')}"


def _check_writable(path: Path) -> None:
    """Refuse a path in a folder where nothing can be written; of folders that do not exist, the nearest that does."""
    nearest = next(place for place in (path.absolute(), *path.absolute().parents) if place.is_dir())
    with refusing(nearest, "a folder that can be written"), tempfile.TemporaryFile(dir=nearest):
        pass


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except OSError as error:
        raise InputError(str(path), "", "a file or folder", str(error.strerror)) from None


def _check_number(option: str, value: object) -> None:
    """Refuse NaN, infinite numbers, and integers that no file holds."""
    for number in value if isinstance(value, tuple) else (value,):
        if isinstance(number, float) and not math.isfinite(number):
            raise InputError(option, "", "a finite number", str(number))
        if isinstance(number, int) and abs(number) > _LARGEST:
            raise InputError(option, "", f"a number of at most {_LARGEST}", f"one of {len(str(number))} digits")


def _check_outputs(
    option: str, outputs: Iterator[tuple[Path, bool]], made: dict[Path, str], inputs: list[Path]
) -> None:
    """Refuse an output that another option names, that is of another kind, or that would replace what must stay."""
    for path, is_folder in outputs:
        real = path.resolve()
        for place in (real, *real.parents):
            if place in made and (place == real or place.suffix == ".parts"):
                raise InputError(option, "", f"a path apart from those of {made[place]}", str(path))
        made[real] = option
        if is_folder:
            if path.exists() and not path.is_dir():
                raise InputError(option, "", "a folder", f"the file {path}")
            continue
        check_replaceable(path)
        if path.exists() and not is_ours(path) and any(folder in real.parents for folder in map(Path.resolve, inputs)):
            raise InputError(
                str(path), "", "a file to write that is not read as well", "one in the folder that is read"
            )
