"""JSON objects read within bounds and written byte for byte alike."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from petkin.errors import InputError

#: No sidecar comes near it; a larger file is something else.
_LARGEST = 16 * 2**20


def read_json(path: Path) -> dict[str, Any]:
    """The object in a JSON file.

    Raises:
        InputError: absent, unreadable, larger than 16 MiB, not JSON, or not an object.
    """
    try:
        if path.stat().st_size > _LARGEST:
            raise InputError(f"{path}: {path.stat().st_size} bytes is too large for a sidecar; is it the right file?")
        content = json.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}).") from error
    except RecursionError as error:
        raise InputError(f"{path}: nested too deeply for a sidecar.") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not UTF-8 text; save it as UTF-8.") from error
    except json.JSONDecodeError as error:
        raise InputError(f"{path}: not valid JSON, line {error.lineno}: {error.msg}.") from error
    if not isinstance(content, dict):
        raise InputError(f"{path}: holds a {type(content).__name__}, not an object of named fields.")
    return content


def merge_json(paths: Iterable[Path]) -> dict[str, Any]:
    """Fields of several sidecars, later files overriding earlier ones (the BIDS inheritance principle, top first)."""
    merged: dict[str, Any] = {}
    for path in paths:
        merged.update(read_json(path))
    return merged


def json_text(content: Mapping[str, Any]) -> str:
    """JSON with the given key order, two spaces, a newline at the end; NaN and infinity become null."""
    return json.dumps(_plain(content), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def _plain(value: Any) -> Any:
    """Numpy scalars and arrays, tuples and paths as what JSON knows."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    if isinstance(value, Path):
        return value.as_posix()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
