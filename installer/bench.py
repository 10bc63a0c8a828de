"""The program that `bench.spec` packs: without arguments it opens the bench, with arguments it is ``capsbayes``."""

import multiprocessing
import sys
from pathlib import Path

from capsbayes.cli import main

if __name__ == "__main__":
    multiprocessing.freeze_support()  # the processes that compute are this program again
    if sys.argv[1:2] == ["-c"]:  # as Python itself is called for a command of the bench
        _, _, code, *sys.argv[1:] = sys.argv
        exec(code)
    else:
        if not sys.argv[1:]:  # after a double click, the working folder is any
            sys.argv += ["app", "--folder", str(Path.home() / "capsbayes-bench")]
        main()
