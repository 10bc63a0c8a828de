"""Tasks give the same results wherever they are computed."""

import os
import subprocess
import sys
from functools import partial

import pytest

from capsbayes import run as workers
from capsbayes.errors import InputError
from capsbayes.run import run_tasks

TASKS = [partial(divmod, number) for number in (7, 8, 9)]


@pytest.mark.parametrize("scheduler", ["synchronous", None])
def test_results_come_in_order_and_tasks_get_what_they_share(scheduler):
    assert run_tasks(TASKS, scheduler, 2, 4) == [(1, 3), (2, 0), (2, 1)]


def test_a_cluster_gives_the_same(tmp_path):
    from distributed import LocalCluster

    with LocalCluster(n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None) as cluster:
        assert run_tasks(TASKS, cluster.scheduler_address, None, 4) == [(1, 3), (2, 0), (2, 1)]
    with pytest.raises(InputError, match=r"scheduler: expected address of a running dask scheduler, got 'nowhere://x'"):
        run_tasks(TASKS, "nowhere://x", None, 4)


def test_without_dask_a_cluster_is_refused_with_the_command_that_installs_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r'scheduler: .* install it with pip install "capsbayes\[cluster\]"'):
        run_tasks(TASKS, "tcp://127.0.0.1:8786", None, 4)


@pytest.mark.parametrize(("limit", "cores"), [("max 100000", 8), ("250000 100000", 3), ("50000 100000", 1), (None, 8)])
def test_the_share_of_a_container_counts_as_cores(limit, cores, tmp_path, monkeypatch):
    share = tmp_path / "cpu.max"
    if limit is not None:
        share.write_text(limit)
    monkeypatch.setattr(workers, "_SHARE_OF_TIME", share)
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: set(range(8)), raising=False)
    assert workers.usable_cores() == cores


SCRIPT = """
import dataclasses
from functools import partial
from capsbayes.run import run_tasks

print("started")

@dataclasses.dataclass
class Own:
    number: int

def added(number, own):
    return Own(number + own.number)

results = run_tasks([partial(added, number) for number in range(3)], None, 2, Own(5))
print(results == [Own(5), Own(6), Own(7)])
"""


def test_a_script_without_a_main_guard_is_not_run_again_by_workers(tmp_path):
    (tmp_path / "script.py").write_text(SCRIPT)
    done = subprocess.run([sys.executable, tmp_path / "script.py"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.split(), done.stderr) == (0, ["started", "True"], "")
