"""The same numbers from the same numbers, wherever in memory they lie.

On processors of Intel, its library of linear algebra takes other paths for arrays that are aligned otherwise, so that
a training that was interrupted went on a little differently. It can be asked not to, by a variable that it reads when
it is first used; on other processors it offers no such mode.

Reference: Intel oneMKL developer guide, "Obtaining numerically reproducible results" (strict conditional numerical
reproducibility).
"""

from __future__ import annotations

import os
import platform
from pathlib import Path

#: Read by the library when it first multiplies.
VARIABLE, STRICT = "MKL_CBWR", "AUTO,STRICT"
_VENDOR = "GenuineIntel"


def keep_repeatable() -> None:
    """Ask for numbers that do not depend on alignment, unless the user has said what to do."""
    if _is_intel():
        os.environ.setdefault(VARIABLE, STRICT)


def _is_intel() -> bool:
    try:
        return _VENDOR in Path("/proc/cpuinfo").read_text()
    except OSError:
        return _VENDOR in platform.processor()
