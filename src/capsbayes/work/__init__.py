"""Long work: finished parts kept on disk, tasks spread over processes or a cluster, and a progress bar."""

from capsbayes.work.progress import progress_bar, tracked
from capsbayes.work.records import Records
from capsbayes.work.store import Store
from capsbayes.work.workers import run_tasks

__all__ = ["Records", "Store", "progress_bar", "run_tasks", "tracked"]
