"""Matrices on one core: petkin's parts run side by side themselves, and its matrices are small.

Threads that share a small matrix wait for each other on busy cores, and sums of another order would change the last
digits. Commands and their workers are started so (an environment variable); this does it for who calls from Python.
"""

from __future__ import annotations

from threadpoolctl import threadpool_limits

#: For a function within which libraries of linear algebra are kept to one core; after it they have those they had.
on_one_core = threadpool_limits.wrap(limits=1, user_api="blas")
