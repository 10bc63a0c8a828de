"""The environment in which a record is made: one thread, one kind of processor, one terminal, one language."""

from __future__ import annotations

import os
import sys
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]

ENVIRONMENT = {
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "NUMBA_NUM_THREADS": "1",
    "OPENBLAS_CORETYPE": "Haswell",  # here and below: what every processor of ten years has, for the same last digits
    "NPY_DISABLE_CPU_FEATURES": "X86_V4 AVX512_ICL AVX512_SPR",
    "NUMBA_CPU_NAME": "haswell",
    "NUMBA_CPU_FEATURES": "",
    "PYTHONHASHSEED": "0",
    "SOURCE_DATE_EPOCH": "946684800",
    "MPLBACKEND": "Agg",
    "COLUMNS": "100",
    "LINES": "40",
    "TERM": "dumb",
    "NO_COLOR": "1",
    "LC_ALL": "C.UTF-8",
    "TZ": "UTC",
    "PYTHONWARNINGS": "ignore::FutureWarning:numba.core.typing.typeof",  # comes only where a kernel is compiled anew
}


def restart_in_it() -> None:
    """Start this program again in the environment, unless it is there already, with the package of this checkout."""
    source = os.pathsep.join([str(REPOSITORY / "src"), str(REPOSITORY)])
    wanted = ENVIRONMENT | {"PYTHONPATH": source, "GOLDEN_RECORD": "1"}
    if any(os.environ.get(name) != value for name, value in wanted.items()):
        os.execve(sys.executable, [sys.executable, *sys.argv], os.environ | wanted)
