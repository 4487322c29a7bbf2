"""petkin: dynamic PET kinetic modelling. Import the rooms (`petkin.kinetics`, `petkin.fitting`, ...) as needed."""

from importlib.metadata import version

__version__ = version("petkin")
