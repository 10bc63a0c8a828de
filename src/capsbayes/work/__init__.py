"""Long work: finished parts on disk, a lock on the output, tasks in processes or on a cluster, and a progress bar."""

from capsbayes.work.digest import digest_of
from capsbayes.work.lock import only_run
from capsbayes.work.progress import progress_bar, tracked
from capsbayes.work.records import Records
from capsbayes.work.steps import keeping_steps, remembered, resumable, step_of, step_task, steps_kept
from capsbayes.work.store import Store
from capsbayes.work.workers import run_tasks

__all__ = [
    "Records",
    "Store",
    "digest_of",
    "keeping_steps",
    "only_run",
    "progress_bar",
    "remembered",
    "resumable",
    "run_tasks",
    "step_of",
    "step_task",
    "steps_kept",
    "tracked",
]
