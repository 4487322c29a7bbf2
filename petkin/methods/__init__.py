"""Methods: one file a way of fitting; `METHODS` is the list of all that petkin offers."""

from petkin.errors import InputError
from petkin.kinetics import MODELS
from petkin.methods.checks import check_choices
from petkin.methods.compartments import compartments
from petkin.methods.frtm import FRTM
from petkin.methods.hybrid import HYBRID
from petkin.methods.logan import LOGAN
from petkin.methods.logan_ref import LOGAN_REF
from petkin.methods.lp_ntpet import LP_NTPET
from petkin.methods.ls2tcm import LS2TCM
from petkin.methods.ma1 import MA1
from petkin.methods.ma2 import MA2
from petkin.methods.method import Method
from petkin.methods.mrtm1 import MRTM1
from petkin.methods.mrtm2 import MRTM2
from petkin.methods.patlak import PATLAK
from petkin.methods.patlak_ref import PATLAK_REF
from petkin.methods.sime import SIMEVND
from petkin.methods.spectral import SPECTRAL
from petkin.methods.srtm import SRTM
from petkin.methods.srtm2 import SRTM2
from petkin.methods.suv import SUV
from petkin.methods.suvr import SUVR

METHODS = (
    *map(compartments, MODELS),
    PATLAK,
    LOGAN,
    MA1,
    MA2,
    LS2TCM,
    SRTM,
    SRTM2,
    FRTM,
    MRTM1,
    MRTM2,
    LOGAN_REF,
    PATLAK_REF,
    LP_NTPET,
    SIMEVND,
    SPECTRAL,
    SUV,
    SUVR,
)


def find_method(label: str) -> Method:
    """The method with this label; HYBRID is one of them once there is a checkpoint.

    Raises:
        InputError: there is none.
    """
    for method in (*METHODS, HYBRID):
        if method.label.lower() == label.lower():
            return method
    raise InputError(f"There is no model {label!r}; choose from {', '.join(m.label for m in METHODS)}.")


__all__ = ["METHODS", "Method", "check_choices", "find_method"]
