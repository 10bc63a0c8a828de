"""All capsules of a bench in one file, and back: names and sizes are checked before anything is written."""

from __future__ import annotations

import json
import re
import stat
import zipfile
import zlib
from pathlib import Path, PureWindowsPath

from capsbayes.app.stated import EXPERIMENT, KINDS, MEASUREMENT, OVERLAY, STATED, new_folder
from capsbayes.errors import InputError
from capsbayes.files.input_file import parsing
from capsbayes.files.output_file import RECORD, guarded, write_file

PACKED = ".bench.zip"
MOST_UNPACKED, MOST_FILES = 2 << 30, 20_000  # bytes, and number
_EXPECTED = "a file in which step 7 saved all capsules"
_NAMED = re.compile(rf'^experiment = ".*[/\\]{re.escape(EXPERIMENT)}"$', re.MULTILINE)  # by its absolute path


def packed(folder: str, most: int) -> None:
    """Write the folders of all capsules into the file `PACKED` of the bench, which `most` bytes limit."""
    bench, listed = Path(folder), (f"*/**/{MEASUREMENT}", f"*/{STATED}")
    tops = {path.relative_to(bench).parts[0] for pattern in listed for path in bench.glob(pattern)}
    shown = (path for top in sorted(tops) for path in sorted((bench / top).rglob("*")) if path.is_file())
    kept = (path for path in shown if path.name in (STATED, RECORD) or path.name[0] != ".")
    files = [path for path in kept if not path.is_symlink()]
    fits = len(files) <= MOST_FILES and sum(path.stat().st_size for path in files) <= MOST_UNPACKED
    with zipfile.ZipFile(bench / PACKED, "w", zipfile.ZIP_DEFLATED, strict_timestamps=False) as archive:
        for path in files if fits else ():
            archive.write(path, path.relative_to(bench))
    if not (files and fits and (bench / PACKED).stat().st_size <= most):
        (bench / PACKED).unlink()
        got = "more: copy the folder itself" if files else "none"
        raise InputError(folder, "", f"capsules that fit into {most >> 20} MB", got)


def unpacked(folder: str, name: str) -> tuple[int, int]:
    """Unpack such a file into new folders of the bench; return how many, and how many were there already."""
    bench, place = Path(folder), Path(name).with_suffix("")
    with parsing(Path(name).name, _EXPECTED), zipfile.ZipFile(name) as archive:
        files = [(info, PureWindowsPath(info.filename)) for info in archive.infolist() if not info.is_dir()]
        _check(files, Path(name).name)
        given = [(info, path.parts[0]) for info, path in files if len(path.parts) == 2 and _is_given(path)]
        sizes = {info.file_size for info, _ in given}
        here = (path for path in bench.glob("*/*") if _is_given(path) and path.is_file())
        sums = {zlib.crc32(path.read_bytes()) for path in here if path.stat().st_size in sizes}
        known = {top for _, top in given} - {top for info, top in given if info.CRC not in sums}
        archive.extractall(place, [info for info, path in files if path.parts[0] not in known])
    found = sorted(place.glob("*"))
    for new in found:
        (top := new_folder(bench, new.name)).rmdir()
        new.rename(top)
        # measurements of films and events name their experiment by its absolute path
        named = f"experiment = {json.dumps(str(top / EXPERIMENT))}"
        for path in top.rglob(MEASUREMENT):
            led, count = _NAMED.subn(named.replace("\\", r"\\"), path.read_text("utf-8", "replace"), count=1)
            if count and (top / EXPERIMENT).is_file():
                with guarded(overwrite=True):
                    write_file(path, led)
    return len(found), len(known)


def _is_given(path: Path | PureWindowsPath) -> bool:
    return path.suffix.lower() in KINDS and path.name != OVERLAY


def _check(files: list[tuple[zipfile.ZipInfo, PureWindowsPath]], where: str) -> None:
    """Refuse files that are not those of capsules, names that lead elsewhere, links, and what is too much."""
    if not any(path.name == MEASUREMENT or path.parts[1:] == (STATED,) for _, path in files):
        raise InputError(where, "", _EXPECTED, "a file without capsules")
    if len(files) > MOST_FILES or sum(info.file_size for info, _ in files) > MOST_UNPACKED:
        raise InputError(where, "", f"{MOST_FILES} files of {MOST_UNPACKED >> 30} GB at most", "more")
    for info, path in files:
        link = stat.S_IFMT(info.external_attr >> 16) not in (0, stat.S_IFREG)
        if link or "\\" in info.filename or path.anchor or ".." in path.parts or len(path.parts) < 2:
            raise InputError(where, "", _EXPECTED, f"{info.filename[:80]!r}, which leads out of a capsule's folder")
