"""Tasks of a process that takes long to be ready; see `capsbayes.app.worker`."""

import os
import time


def warm():
    time.sleep(2.0)


def ended():
    os._exit(1)


TASKS = {"same": lambda value: value, "slept": lambda length: time.sleep(length), "ended": ended}
