"""`python -m petkin` is the command `petkin`."""

from petkin.cli import main

if __name__ == "__main__":
    main()
