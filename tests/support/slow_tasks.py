"""Tasks of a process that takes long to be ready; see `capsbayes.app.worker`."""

import os
import time

from capsbayes.errors import InputError


def warm():
    time.sleep(2.0)


def ended():
    os._exit(1)


def refused():
    raise InputError("cells.rtdc", "", "a rate", "none", "give --flow-rate")


TASKS = {"same": lambda value: value, "slept": lambda length: time.sleep(length), "ended": ended, "refused": refused}
