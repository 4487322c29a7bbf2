"""Where compiled code is kept: a folder that belongs to exactly these sources.

The compiler looks only at the file of a function to see whether its code is still good, not at the files of what that
function calls; after an update of some files, old code would go on computing with old formulas. So the folder is named
after all of petkin's sources: any change begins a new one, and the old ones go.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
import sys
from pathlib import Path

#: Read by the compiler when it is first loaded.
VARIABLE = "NUMBA_CACHE_DIR"
_PREFIX = "petkin-compiled-"


def keep_compiled_code(package: Path) -> None:
    """Have compiled code kept below the user's folder for it, or else below the package; where neither can be written,
    it is left to the compiler.

    Args:
        package: folder of petkin's sources.
    """
    given = os.environ.get(VARIABLE)
    if given and Path(given).name.startswith(_PREFIX):
        return  # a process that petkin started
    base = Path(given) if given else package / "__pycache__"
    folder = base / f"{_PREFIX}{fingerprint(package)}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return
    if not os.access(folder, os.W_OK):
        return
    for old in base.glob(f"{_PREFIX}*"):
        if old != folder:
            with contextlib.suppress(OSError):
                shutil.rmtree(old)
    os.environ[VARIABLE] = str(folder)
    if "numba" in sys.modules:
        sys.modules["numba"].config.CACHE_DIR = str(folder)


def fingerprint(package: Path) -> str:
    """A name for the state of all sources: their places, sizes and times of change."""
    digest = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        state = path.stat()
        digest.update(f"{path.relative_to(package)} {state.st_size} {state.st_mtime_ns}\n".encode())
    return digest.hexdigest()[:16]
