"""Effects of a user's own, from the one Python file that the option ``--effects`` names, which is run to read it."""

from __future__ import annotations

import hashlib
import sys
import traceback
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Annotated, Any

import capsbayes as cb
from capsbayes.cli.command import Reads
from capsbayes.errors import BrokenPromiseError, InputError
from capsbayes.parameters import COORDINATES, Parameter

if TYPE_CHECKING:
    from capsbayes.model import Effect, ForwardModel

EffectsFile = Annotated[
    Path | None, Reads("Python file with effects of your own, added to those that are known. Its code is run.")
]

_MODULE = "capsbayes_effects_file"  # under which classes of the file can be pickled
_ADVICE = "see docs/diagnosing.md#an-effect-of-your-own"


@dataclass(frozen=True)
class OwnEffects:
    """Effects of a file by name of their parameter, its fingerprint, and both as results state them; or nothing."""

    effects: Mapping[str, Effect] = field(default_factory=dict)
    sha256: str = ""
    described: Mapping[str, Any] = field(default_factory=dict)


def own_effects(path: Path | None, known: Mapping[str, Effect], model: ForwardModel) -> OwnEffects:
    """Run a file and return its effects, objects or classes made without arguments; check their names and promises."""
    if path is None:
        return OwnEffects()
    from capsbayes.files.input_file import read_bytes

    content = read_bytes(path)
    taken = _taken_names(known)
    effects: dict[str, Effect] = {}
    for label, effect in _effects_of(path, _run(path, content)):
        _check_complete(path, label, effect)
        for name in (effect.parameter.name, effect.name):
            if name in taken:
                got = f"{name!r}, that of {taken[name]}"
                raise InputError(str(path), label, "a name that is not taken", got, "choose another")
        taken |= {effect.parameter.name: label, effect.name: label}
        effects[effect.parameter.name] = effect
        try:
            cb.testing.check_effect(effect, model)
        except BrokenPromiseError as error:
            raise BrokenPromiseError(f"{path}: {error.subject}", error.promise, error.found) from None
    if not effects:
        expected = "an effect: a class with `parameter`, `prior` and `__call__`, or an object of one"
        raise InputError(str(path), "", expected, "none", _ADVICE)
    sha256 = hashlib.sha256(content).hexdigest()
    return OwnEffects(effects, sha256, {"effects_file": {"file": str(path), "sha256": sha256, "effects": [*effects]}})


def _taken_names(known: Mapping[str, Effect]) -> dict[str, str]:
    """Return what each name stands for that an effect or its parameter cannot have."""
    from capsbayes.diagnosis import NOTHING, UNKNOWN
    from capsbayes.model import CIRCUMSTANCES

    inputs = ("capillary_number", "size_ratio", *CIRCUMSTANCES, *COORDINATES)
    taken = dict.fromkeys(inputs, "an input of the models") | dict.fromkeys((NOTHING, UNKNOWN), "a verdict")
    for name, effect in known.items():
        taken |= dict.fromkeys((name, effect.name), f"{effect.name} in the catalogue")
    return taken


def _run(path: Path, content: bytes) -> ModuleType:
    """Run a file, and return the module with what it defines."""
    import cloudpickle

    module = ModuleType(_MODULE)
    module.__file__ = str(path)
    sys.modules[_MODULE] = module
    cloudpickle.register_pickle_by_value(module)  # worker processes do not have the module
    try:
        exec(compile(content, str(path), "exec"), vars(module))  # what the option is for
    except SyntaxError as error:
        raise InputError(str(path), f"line {error.lineno}" if error.lineno else "", "Python", error.msg) from None
    except (Exception, SystemExit) as error:
        frames = [frame for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)]
        line = f"line {frames[-1].lineno}" if frames else ""
        raise InputError(str(path), line, "Python that runs", f"{type(error).__name__}: {error}") from None
    return module


def _effects_of(path: Path, module: ModuleType) -> Iterator[tuple[str, Effect]]:
    """Yield name and effect of the objects at the top of a module, and of its classes of which there is no object."""
    objects = {
        name: value
        for name, value in vars(module).items()
        if not isinstance(value, type | ModuleType) and _looks_like_an_effect(type(value))
    }
    yield from objects.items()
    made = {type(value) for value in objects.values()}
    for name, value in vars(module).items():
        here = isinstance(value, type) and value.__module__ == module.__name__
        if here and value not in made and _looks_like_an_effect(value):
            try:
                yield name, value()
            except Exception as error:
                expected = "a class that is made without arguments, or an object of it"
                raise InputError(str(path), name, expected, f"{type(error).__name__}: {error}", _ADVICE) from None


def _parts() -> tuple[str, ...]:
    """Return the names of what an effect has besides its call."""
    from capsbayes.model import Effect

    return tuple(name for name, value in vars(Effect).items() if isinstance(value, property))


def _looks_like_an_effect(kind: type) -> bool:
    called = any("__call__" in vars(base) for base in kind.__mro__)
    return called and any(hasattr(kind, name) for name in ("parameter", "null_value", "separated_by"))


def _check_complete(path: Path, label: str, effect: Effect) -> None:
    missing = [name for name in _parts() if not hasattr(effect, name)]
    if missing:
        raise InputError(str(path), label, f"an effect with {', '.join(_parts())}", f"one without {', '.join(missing)}")
    if not isinstance(effect.parameter, Parameter):
        got = repr(effect.parameter)
        raise InputError(str(path), f"{label}.parameter", "a capsbayes.parameters.Parameter", got, _ADVICE)
