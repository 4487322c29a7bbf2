"""`python -m petkin_bench` is the command `petkin-bench`; torchrun starts it so."""

from petkin_bench.cli import main

if __name__ == "__main__":
    main()
