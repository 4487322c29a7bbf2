"""petkin_bench: the engine on physics systems, and benchmarks of the fit against named baselines."""

import os

# Read when numpy is first loaded: a baseline is compared on one thread, as `petkin` itself runs (`petkin.cli.app`).
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
