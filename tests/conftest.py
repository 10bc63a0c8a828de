"""Give each of pytest's worker processes one thread."""

import os

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # read when numpy is first imported
    os.environ.setdefault(name, "1")
