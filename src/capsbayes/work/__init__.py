"""Long work: finished parts on disk, a lock on the output, tasks in processes or on a cluster, and a progress bar."""

from capsbayes.work.lock import only_run
from capsbayes.work.progress import progress_bar, tracked
from capsbayes.work.records import Records
from capsbayes.work.store import Store
from capsbayes.work.workers import run_tasks

__all__ = ["Records", "Store", "only_run", "progress_bar", "run_tasks", "tracked"]
