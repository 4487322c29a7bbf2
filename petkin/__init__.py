"""petkin: dynamic PET kinetic modelling. Import the rooms (`petkin.kinetics`, `petkin.fitting`, ...) as needed."""

from importlib.metadata import version
from pathlib import Path

from petkin.compiled import keep_compiled_code

keep_compiled_code(Path(__file__).parent)

__version__ = version("petkin")
