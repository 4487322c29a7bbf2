"""petkin_bench: the engine on physics systems, and benchmarks of the fit against named baselines."""
