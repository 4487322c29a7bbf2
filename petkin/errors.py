"""The errors petkin raises on purpose. A message says what is wrong, the value, where, and what to do about it."""


class PetkinError(Exception):
    """Root of every error that petkin raises on purpose; the command line prints its message and exits with 2."""


class InputError(PetkinError, ValueError):
    """A file, option or argument that cannot be used as it is."""


class NumericalError(PetkinError, RuntimeError):
    """A computation that did not reach its result."""
