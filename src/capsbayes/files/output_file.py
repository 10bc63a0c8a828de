"""Files that are written: whole or not at all, never over an input, and over nothing that another program wrote.

Every file of the package is written here. Inside `guarded`, which commands and long computations enter, a file that
exists is replaced only if it is byte for byte what was written there before: each folder keeps the hashes of what was
written into it in a file `RECORD`, in the format of sha256sum.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import io
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from capsbayes.errors import InputError, NoRoomError

if TYPE_CHECKING:
    import xarray as xr

RECORD = ".capsbayes.sha256"  # in each folder: hashes of what was written into it, as sha256sum writes them


@dataclass(frozen=True)
class Guard:
    """Promise that holds while a command runs."""

    overwrite: bool = False  # true if files that were not written here may be replaced
    inputs: set[tuple[int, int]] = field(default_factory=set)  # device and inode of each; never replaced
    updated: frozenset[tuple[int, int]] = frozenset()  # files that are read and written back with more in them


_guard: ContextVar[Guard | None] = ContextVar("guard", default=None)
_waiting: ContextVar[dict[Path, Callable[[Path], object]] | None] = ContextVar("waiting", default=None)


@contextlib.contextmanager
def guarded(inputs: Iterable[Path] = (), *, updated: Iterable[Path] = (), overwrite: bool = False) -> Iterator[None]:
    """Protect, within this block, inputs and files that another program wrote or somebody changed from being replaced.

    Files of `updated` are read and written back with more in them. With `overwrite`, all but inputs may be replaced.
    """
    outer = _guard.get() or Guard()
    own = frozenset(_identity(path) for path in updated if path.exists())
    with set_within(_guard, Guard(overwrite or outer.overwrite, outer.inputs, own | outer.updated)):
        for path in inputs:
            note_input(path)
        yield


def unguarded() -> contextlib.AbstractContextManager[None]:
    """Write the bookkeeping of unfinished work in this block: damaged files of it are replaced, none is recorded."""
    return set_within(_guard, None)


@contextlib.contextmanager
def set_within(variable: ContextVar[Any], value: object) -> Iterator[None]:
    """Give a variable of the context a value in this block."""
    token = variable.set(value)
    try:
        yield
    finally:
        variable.reset(token)


def note_input(path: Path) -> None:
    """Remember a file that is read, so that nothing replaces it in the same block of `guarded`."""
    guard = _guard.get()
    if guard is not None:
        with contextlib.suppress(OSError, ValueError):
            guard.inputs.add(_identity(path))


def _identity(path: Path) -> tuple[int, int]:
    status = path.stat()
    return status.st_dev, status.st_ino


def is_ours(path: Path) -> bool:
    """Return True for a file that is byte for byte what was written there under `guarded`."""
    lines = _recorded(path.parent)
    return bool(lines) and _line(path, _digest(path)) in lines


def check_replaceable(path: Path) -> None:
    """Refuse a file whose replacement would destroy something."""
    guard = _guard.get()
    if path.is_dir():
        raise InputError(str(path), "", "the name of a file to write", "a folder")
    if guard is None or not os.path.lexists(path):
        return
    if path.exists() and _identity(path) in guard.updated:
        return
    if path.exists() and _identity(path) in guard.inputs:
        raise InputError(str(path), "", "a file to write that is not read as well", "an input", "choose another name")
    if not guard.overwrite and not (path.exists() and is_ours(path)):
        advice = "choose another name, or use --overwrite (in Python guarded(overwrite=True))"
        got = "a file that capsbayes did not write, or that was changed since"
        raise InputError(str(path), "", "no file, or a result to replace", got, advice)


def make_folder(path: Path) -> None:
    """Make a folder with its parents, if it does not exist."""
    with refusing(path, "a folder that can be made"):
        path.mkdir(parents=True, exist_ok=True)


def write_file(path: str | os.PathLike[str], content: bytes | str) -> Path:
    """Write a file whole or not at all; its folder is made if it does not exist."""
    raw = content.encode() if isinstance(content, str) else content
    return _written(Path(path), lambda place: place.write_bytes(raw))


def write_lines(path: str | os.PathLike[str], lines: Iterable[str]) -> Path:
    """Write a file of text as `write_file` does, line by line, so that memory never holds all of it."""

    def write(place: Path) -> None:
        with place.open("wb") as file:
            file.writelines(line.encode() for line in lines)

    return _written(Path(path), write)


def _written(path: Path, write: Callable[[Path], object]) -> Path:
    waiting = _waiting.get()
    if waiting is None:
        _commit({path: write})
    else:
        waiting[path] = write
    return path


@contextlib.contextmanager
def together() -> Iterator[None]:
    """Keep what is to be written in this block, and write all of it at the end: all files or none."""
    if _waiting.get() is not None:
        yield
        return
    files: dict[Path, Callable[[Path], object]] = {}
    with set_within(_waiting, files):
        yield
    _commit(files)


def write_dataset(
    path: str | os.PathLike[str],
    dataset: xr.Dataset,
    encoding: Mapping[str, Any] | None = None,
    groups: Mapping[str, xr.Dataset] = MappingProxyType({}),
) -> Path:
    """Write a dataset as a NetCDF file, as `write_file` does."""
    import h5netcdf
    from xarray.backends import H5NetCDFStore

    def write(place: Path) -> None:
        content = io.BytesIO()  # HDF5 itself ends the process where writing fails, as on a full disk
        with h5netcdf.File(content, "w") as file:
            dataset.dump_to_store(H5NetCDFStore(file), encoding=encoding)
            for name, group in groups.items():  # xarray.DataTree would import dask, which takes as long as sampling
                group.dump_to_store(H5NetCDFStore(file.create_group(name)))
        place.write_bytes(content.getbuffer())

    return _written(Path(path), write)


def _commit(files: Mapping[Path, Callable[[Path], object]]) -> None:
    """Write all files under other names, then rename them."""
    partial: dict[Path, Path] = {}
    made: list[Path] = []
    try:
        for path, write in files.items():
            with refusing(path, "a file that can be written"):
                made += [place for place in (path.parent, *path.parent.parents) if not place.exists()][::-1]
                path.parent.mkdir(parents=True, exist_ok=True)
                check_replaceable(path)
                partial[path] = path.with_name(f".{path.name[:100]}.{os.getpid()}.tmp")
                write(partial[path])
        for path in partial:
            with refusing(path, "a file that can be written"):
                if _guard.get() is not None:
                    _add_to_record(path, _digest(partial[path]))
                os.replace(partial[path], path)
        made = []
    finally:
        for path in partial.values():
            path.unlink(missing_ok=True)
        for folder in reversed(made):
            with contextlib.suppress(OSError):
                folder.rmdir()


def _recorded(folder: Path) -> set[str]:
    """Return the lines of the record of a folder."""
    try:
        return set((folder / RECORD).read_text(encoding="utf-8", errors="replace").splitlines())
    except OSError:
        return set()


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _line(path: Path, digest: str) -> str:
    return f"{digest}  {path.name}"


def _add_to_record(path: Path, digest: str) -> None:
    line = _line(path, digest)
    if line in _recorded(path.parent):
        return
    record = path.with_name(RECORD)
    before = record.stat().st_size if record.exists() else None
    try:
        with record.open("ab") as file:  # one short write: lines of several processes do not mix
            file.write(f"{line}\n".encode())
    except OSError:
        with contextlib.suppress(OSError):
            record.unlink() if before is None else os.truncate(record, before)
        raise


@contextlib.contextmanager
def refusing(path: Path, expected: str) -> Iterator[None]:
    """Turn an error of the system into one line with the path and the reason."""
    if "\0" in str(path):
        raise InputError(repr(str(path)), "", expected, "a name that no file can have")
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            advice = "make room and start again: what is finished is kept"
            raise NoRoomError(str(path), "", "room on the disk", reason, advice) from None
        raise InputError(str(path), "", expected, reason) from None
