"""The command line as ``python -m capsbayes``, where the script ``capsbayes`` is not on the path."""

from capsbayes.cli import main

if __name__ == "__main__":  # modules are imported to be documented, too
    main()
