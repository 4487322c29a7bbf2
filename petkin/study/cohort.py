"""Many scans on many processes: dask.distributed runs them, and what it gives is what one process would have given.

Processes exchange scans, progress and small numbers alone: images and results lie in files that all of them see.
"""

from __future__ import annotations

import logging
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol, TypeVar

from distributed import Client, LocalCluster, WorkerPlugin, as_completed, get_worker, worker_client
from distributed.scheduler import KilledWorker

from petkin.errors import PetkinError
from petkin.io.atomic import remove_orphans
from petkin.study.fit_scan import Progress
from petkin.study.outcome import Fitted
from petkin.study.resources import Execution, Spread

_TOPIC = "petkin-progress"
#: Seconds to wait for a scheduler, and for its first worker.
_PATIENCE = 30
#: Blocks of voxels that wait for a worker at a time, a worker: what comes back is held until it is written.
_AHEAD = 2


class _Job(Protocol):
    @property
    def source(self) -> Any: ...
    @property
    def out(self) -> Path: ...


Job = TypeVar("Job", bound=_Job)
Fit = Callable[[Job, Progress, Spread, int], Fitted]


def fit_on_cluster(
    fit: Fit[Job], jobs: Sequence[Job], execution: Execution, progress: Progress
) -> list[Fitted | PetkinError]:
    """Fit scans on workers of this machine, or on those of a scheduler; answers in the order of the jobs.

    A worker that dies is replaced and its scan fitted again elsewhere. Where there are fewer scans than workers, their
    voxels are fitted in blocks by all of them.

    Args:
        fit: fits one scan in the process that calls it.
        jobs: the scans.
        execution: which workers.
        progress: told what is being done, and how far all of it is.

    Raises:
        PetkinError: the scheduler cannot be reached.
    """
    try:
        with _cluster(execution) as client:
            return _gather(client, fit, jobs, progress)
    finally:
        for folder in {path for job in jobs for path in (job.out, job.out.parent)}:
            remove_orphans(folder)


def _gather(client: Client, fit: Fit[Job], jobs: Sequence[Job], progress: Progress) -> list[Fitted | PetkinError]:
    far = [0.0] * len(jobs)

    def told(event: tuple[float, tuple[int, str, float]]) -> None:
        i, step, done = event[1]
        far[i] = max(far[i], done)
        progress(f"{jobs[i].source.label}: {step}", sum(far) / len(far))

    client.subscribe_topic(_TOPIC, told)
    workers = len(client.scheduler_info(n_workers=-1)["workers"])
    helpers = workers if len(jobs) < workers else 1
    futures = [client.submit(_fit, fit, job, i, helpers, pure=False) for i, job in enumerate(jobs)]
    for future in as_completed(futures):
        i = futures.index(future)
        told((0.0, (i, "done", 1.0)))
    return [_answer(future) for future in futures]


def _answer(future: Any) -> Fitted | PetkinError:
    try:
        return future.result()
    except PetkinError as error:
        return error
    except KilledWorker:
        return PetkinError(
            "its worker died again and again, most likely for want of memory; give fewer workers or less --memory."
        )


def _fit(fit: Fit[Job], job: Job, i: int, helpers: int) -> Fitted:
    """Fit one scan on the worker that this runs on."""
    worker = get_worker()

    def tell(step: str, done: float) -> None:
        worker.log_event(_TOPIC, (i, step, done))

    return replace(fit(job, tell, _spread if helpers > 1 else map, helpers), fit=None)


def _spread(work: Callable[[slice], Any], parts: Sequence[slice]) -> Iterator[Any]:
    """`work` on every part by all workers, a few parts ahead of the one that is asked for."""
    with worker_client() as client:
        ahead = _AHEAD * len(client.scheduler_info(n_workers=-1)["workers"])
        waiting = [client.submit(work, part, pure=False) for part in parts[:ahead]]
        for i in range(len(parts)):
            answer = waiting.pop(0).result()
            if i + ahead < len(parts):
                waiting.append(client.submit(work, parts[i + ahead], pure=False))
            yield answer


@contextmanager
def _cluster(execution: Execution) -> Iterator[Client]:
    """Workers, for as long as the block lasts."""
    if execution.scheduler:
        try:
            client = Client(execution.scheduler, timeout=_PATIENCE)
            client.wait_for_workers(1, timeout=_PATIENCE)
        except (OSError, ValueError) as error:  # TimeoutError is an OSError
            raise PetkinError(
                f"--scheduler {execution.scheduler}: no scheduler with workers there ({error})."
            ) from error
        with client:
            yield client
        return
    threads = str(max((os.cpu_count() or 1) // execution.workers, 1))
    with (
        LocalCluster(
            n_workers=execution.workers,
            threads_per_worker=1,
            # no dashboard; what else listens takes any free port: None asks for 8787 and complains where it is taken
            dashboard_address="127.0.0.1:0",
            scheduler_kwargs={"dashboard": False},
            memory_limit=0,  # petkin keeps to a limit of its own
            # what fails is answered; the scheduler of a hurried end complains of lines that are closed
            silence_logs=logging.CRITICAL + 1,
            env={"NUMBA_NUM_THREADS": threads, "OPENBLAS_NUM_THREADS": "1"},
        ) as cluster,
        Client(cluster) as client,
    ):
        client.register_plugin(_LeaveSignals())
        yield client


class _LeaveSignals(WorkerPlugin):
    """Ctrl-C in a terminal reaches all its processes; the one that was started there ends the others."""

    def setup(self, worker: Any) -> None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
