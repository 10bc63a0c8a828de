#!/bin/sh
# Opens the bench by a double click, on a Mac and on Linux (bench.bat does so on Windows). The first time, and after an
# update, it installs what the bench needs into a folder next to this file. Options are those of capsbayes app.
set -eu
cd "$(dirname "$0")"
if [ ! -e .bench/installed ] || [ pyproject.toml -nt .bench/installed ]; then
    echo "The bench is being installed. It takes some minutes and 1.2 GB, this once."
    for python in python3.13 python3.12 python3.11 python3; do
        if "$python" -m venv .bench 2>/dev/null; then break; fi
    done
    [ -x .bench/bin/python ] || { echo "Python 3.11 or newer is needed, from python.org." >&2; exit 1; }
    .bench/bin/python -m pip install --quiet ".[app]"
    touch .bench/installed
fi
exec .bench/bin/python -m capsbayes app "$@"
