"""A lock on what a run writes, so that no second run writes it at the same time; it dies with its owner."""

from __future__ import annotations

import contextlib
import logging
import os
import socket
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from capsbayes.errors import InputError
from capsbayes.files.output_file import refusing

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl

_logger = logging.getLogger(__name__)

_BEYOND = 1 << 20  # a byte far behind the name of the owner, which stays readable on Windows


@contextlib.contextmanager
def only_run(out: Path) -> Iterator[None]:
    """Refuse to write `out` while another run does; make the folder of `out` if it does not exist."""
    # The operating system holds the lock as long as the process lives, on the file ``.NAME.lock`` next to a file, or
    # ``.lock`` in a folder. Without locks there, a warning is logged: results are whole even so, but work may be done
    # twice.
    with refusing(out, "a place where files can be written"):
        real = out.resolve()
        path = real / ".lock" if real.is_dir() else real.with_name(f".{real.name}.lock")
        path.parent.mkdir(parents=True, exist_ok=True)
        file = _locked(path)
    if file is None:
        owner = path.read_text(encoding="utf-8", errors="replace").strip() or "another process"
        raise InputError(str(out), "", "no other run that writes it", owner, "let it end, or choose another output")
    with file:
        try:
            yield
        finally:
            with contextlib.suppress(OSError):
                path.unlink()


def _locked(path: Path) -> IO[str] | None:
    """Return the locked file, None if another process holds the lock."""
    while True:
        file = path.open("a+", encoding="utf-8")
        if not _lock(file, path):
            file.close()
            return None
        with contextlib.suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(file.fileno()), path.stat()):
                break
        file.close()  # its owner removed it meanwhile
    with contextlib.suppress(OSError):  # as on a full disk: the lock counts, not the name
        file.truncate(0)
        file.write(f"process {os.getpid()} on {socket.gethostname()}\n")
        file.flush()
    return file


def _lock(file: IO[str], path: Path) -> bool:
    """Lock a file; return False if another process has locked it."""
    try:
        if sys.platform == "win32":
            file.seek(_BEYOND)
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        else:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        return False
    except OSError as error:  # NFS without its lock service, some parallel file systems
        _logger.warning("%s cannot be locked (%s): see that no other run writes there.", path, error.strerror)
    return True
