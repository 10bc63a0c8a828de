"""Makes the modules beside this file importable from every folder of tests; one thread for each of pytest's workers."""

import os
import sys
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # read when numpy is first imported
    os.environ.setdefault(name, "1")
sys.path.insert(0, str(Path(__file__).parent))
