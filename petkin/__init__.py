"""petkin: dynamic PET kinetic modelling. Import the rooms (`petkin.kinetics`, `petkin.fitting`, ...) as needed."""

from importlib.metadata import version
from pathlib import Path

from petkin.compiled import keep_compiled_code
from petkin.repeatable import keep_repeatable

keep_compiled_code(Path(__file__).parent)
keep_repeatable()

__version__ = version("petkin")
