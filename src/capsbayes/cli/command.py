"""What makes a function a command: its options, its paths and numbers, checked before any work starts."""

from __future__ import annotations

import contextlib
import functools
import inspect
import io
import math
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextvars import ContextVar
from dataclasses import dataclass, fields
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated, Any, get_type_hints

from typer.models import ArgumentInfo, OptionInfo

from capsbayes.errors import InputError
from capsbayes.files.output_file import check_replaceable, guarded, is_ours, refusing

_LARGEST = 2**63 - 1  # integer that a NetCDF file holds

wants_json = ContextVar("wants_json", default=False)
"""True while a command runs that is to print its result as JSON."""

Written = Callable[[Mapping[str, Any]], tuple[str, ...]] | tuple[str, ...]


class Option(OptionInfo):
    """Option of a command; its name is that of the parameter if none is given."""

    def __init__(self, help: str, *names: str, **how: Any) -> None:
        super().__init__(default=..., param_decls=names, help=help, **how)


class Input(ArgumentInfo):
    """Argument that names what a command reads; `updated` if the command writes it back with more in it."""

    def __init__(self, help: str, *, updated: bool = False) -> None:
        super().__init__(default=..., help=help)
        self.updated = updated


class Reads(Option):
    """Option that names a file or folder that a command reads."""

    updated = False


class Writes(Option):
    """Option that names what a command writes.

    `suffixes` are the endings that the name of a file may have; none for a folder. `next_to` is what is written next to
    it, as formats of its ``{name}`` and ``{stem}``, globs among them; one that ends in ``/`` is a folder of its own.
    `within` is what is written into the folder, globs or a function of the command's values that returns them.
    """

    def __init__(self, help: str, *suffixes: str, next_to: tuple[str, ...] = (), within: Written = ()) -> None:
        super().__init__(help)
        self.suffixes, self.next_to, self.within = suffixes, next_to, within

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
        for place in path.absolute().parents:
            if place.exists() and not place.is_dir():
                raise InputError(option, "", "a folder", f"the file {place}")
        _check_writable(path)

    def outputs(self, path: Path, values: Mapping[str, Any]) -> Iterator[tuple[Path, bool]]:
        """Yield each path that is written and exists or has a name known before, and True for a folder."""
        yield path, not self.suffixes
        for form in self.next_to:
            place = path.with_name(form.format(name=path.name, stem=path.stem).rstrip("/"))
            places = path.parent.glob(place.name) if "*" in form else [place]
            yield from ((file, form.endswith("/")) for file in places)
        for form in self.within(values) if callable(self.within) else self.within:
            yield from ((file, False) for file in (path.glob(form) if "*" in form else [path / form]))


def results(*names: str) -> Writes:
    """Return the declaration of a folder for these files."""
    return Writes(f"Folder for {', '.join(names)}.", within=names)


@dataclass(frozen=True)
class Options:
    """Options that belong together; a command takes them as one parameter."""

    @classmethod
    def parameters(cls) -> list[inspect.Parameter]:
        """Return the options as parameters of a function."""
        hints = get_type_hints(cls, include_extras=True)
        return [_parameter(each.name, hints[each.name], each.default) for each in fields(cls)]

    def given(self) -> dict[str, Any]:
        """Return the values that are not the default, by the option as it is typed."""
        return {
            option_name(each): value
            for each in self.parameters()
            if (value := getattr(self, each.name)) != each.default
        }


_ADDED = {
    "as_json": Option("Print the result as JSON.", "--json"),
    "overwrite": Option("Replace files that capsbayes did not write, or that were changed since.", "--overwrite"),
    "quiet": Option("Print nothing but what went wrong; with --json, nothing but the JSON.", "--quiet"),
}


def command(function: Callable[..., None], *, has_result: bool = True) -> Callable[..., None]:
    """Make a function a command: paths and numbers are checked before it runs, and it replaces nothing that must stay.

    A parameter that is `Options` becomes these options; ``--quiet`` and, where something is written, ``--overwrite``
    are added, and ``--json`` to a command that has a result.
    """
    groups: dict[str, type[Options]] = {}
    typed: list[inspect.Parameter] = []
    for each in inspect.signature(function, eval_str=True).parameters.values():
        kind = each.annotation
        if isinstance(kind, type) and issubclass(kind, Options):
            groups[each.name] = kind
            typed += kind.parameters()
        else:
            typed.append(_parameter(each.name, kind, each.default))

    @functools.wraps(function)
    def run(*, quiet: bool, as_json: bool = False, overwrite: bool = False, **given: Any) -> None:
        wants_json.set(as_json)
        with _silenced() if quiet else contextlib.nullcontext(), _protected(typed, given, overwrite=overwrite):
            for name, group in groups.items():
                given[name] = group(**{field.name: given.pop(field.name) for field in fields(group)})
            function(**given)

    writes = any(isinstance(path_of(each), Writes) for each in typed)
    wanted = {"as_json": has_result, "overwrite": writes, "quiet": True}
    added = [_parameter(name, Annotated[bool, _ADDED[name]], False) for name in wanted if wanted[name]]
    run.__signature__ = inspect.Signature([*typed, *added])  # type: ignore[attr-defined]
    return run


def _parameter(name: str, annotation: Any, default: Any) -> inspect.Parameter:
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, annotation=annotation, default=default)


def path_of(parameter: inspect.Parameter) -> Input | Reads | Writes | None:
    """Return how a parameter is declared that names a path; None for another."""
    metadata = getattr(parameter.annotation, "__metadata__", ())
    return next((about for about in metadata if isinstance(about, Input | Reads | Writes)), None)


def option_name(parameter: inspect.Parameter) -> str:
    """Return the name of an option as it is typed."""
    metadata = getattr(parameter.annotation, "__metadata__", ())
    names = (name for about in metadata for name in getattr(about, "param_decls", None) or ())
    return next(names, f"--{parameter.name.replace('_', '-')}")


@contextlib.contextmanager
def _silenced() -> Iterator[None]:
    """Leave files, mistakes and JSON of what is printed."""
    no_terminal: Any = SimpleNamespace(write=sys.stderr.write, flush=sys.stderr.flush, isatty=lambda: False)
    printed = contextlib.nullcontext() if wants_json.get() else contextlib.redirect_stdout(io.StringIO())
    with contextlib.redirect_stderr(no_terminal), printed:  # progress bars are drawn on terminals alone
        yield


@contextlib.contextmanager
def _protected(typed: Iterable[inspect.Parameter], given: Mapping[str, Any], *, overwrite: bool) -> Iterator[None]:
    """Check the paths and numbers of a command, and let it replace nothing that must stay."""
    reads, updated = set[Path](), set[Path]()
    writes: list[tuple[str, Writes, Path]] = []
    for each in typed:
        about, value = path_of(each), given[each.name]
        _check_number(option_name(each), value)
        if value is None or about is None:
            continue
        path = Path(value)
        if isinstance(about, Writes):
            writes.append((option_name(each), about, path))
            continue
        with refusing(path, "a file or folder"):
            if path.exists():
                (updated if about.updated else reads).add(path)
    with guarded(reads, updated=updated, overwrite=overwrite):
        for path in updated:
            _check_writable(path)
        made: dict[Path, str] = {}
        for option, about, path in writes:
            about.check(option, path)
            _check_outputs(option, about.outputs(path, given), made, reads | updated)
        yield


def _check_writable(path: Path) -> None:
    """Refuse a path in a folder where nothing can be written; of folders that do not exist, the nearest that does."""
    nearest = next(place for place in (path.absolute(), *path.absolute().parents) if place.is_dir())
    with refusing(nearest, "a folder that can be written"), tempfile.TemporaryFile(dir=nearest):
        pass


def _check_number(option: str, value: object) -> None:
    """Refuse NaN, infinite numbers, and integers that no file holds."""
    for number in value if isinstance(value, tuple) else (value,):
        if isinstance(number, float) and not math.isfinite(number):
            raise InputError(option, "", "a finite number", str(number))
        if isinstance(number, int) and abs(number) > _LARGEST:
            raise InputError(option, "", f"a number of at most {_LARGEST}", f"one of {len(str(number))} digits")


def _check_outputs(option: str, outputs: Iterator[tuple[Path, bool]], made: dict[Path, str], inputs: set[Path]) -> None:
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
            expected = "a file to write that is not read as well"
            raise InputError(str(path), "", expected, "one in the folder that is read")
