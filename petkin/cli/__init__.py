"""The `petkin` command: each verb is a file here, of a few lines; the work is in `petkin.study`."""

from petkin.cli.app import main

__all__ = ["main"]
