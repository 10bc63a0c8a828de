"""A folder for numba's compiled functions, where neither the installation nor the home of the user can be written."""

from __future__ import annotations

import os
from pathlib import Path

_VARIABLE = "NUMBA_CACHE_DIR"


def provide_numba_folder() -> None:
    """Let numba keep compiled functions in a temporary folder if it would find no other; it raises without one."""
    caches = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))
    nearest = next((place for place in (caches, *caches.parents) if place.exists()), caches)
    if os.environ.get(_VARIABLE) or any(os.access(place, os.W_OK) for place in (Path(__file__).parent, nearest)):
        return
    import atexit
    import contextlib
    import logging
    import shutil
    import tempfile

    with contextlib.suppress(OSError):  # then numba says it
        folder = tempfile.mkdtemp(prefix="capsbayes-")
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
        os.environ[_VARIABLE] = folder
        os.environ.setdefault("MPLCONFIGDIR", folder)  # of which matplotlib would warn as well
        logging.getLogger(__name__).warning(
            "Compiled functions are compiled at each start, for neither %s nor %s can be written; set %s to a folder",
            Path(__file__).parent,
            caches,
            _VARIABLE,
        )
