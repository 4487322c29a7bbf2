"""Compiled functions, and names for their code on disk that no two of them share.

The compiler numbers the versions of a function, one for every set of types, as they come. Two processes that compile
two of them at the same moment both take the next number, and whoever then asks for the one may get the code of the
other: made for other types or for arrays that lie otherwise in memory, and run without a word. Here a version is named
after its types, so processes that meet write the same code twice or each its own.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numba
from numba.core.caching import FunctionCache, IndexDataCacheFile
from numba.core.types import unliteral


def njit(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function when it is first called, keep its code for the next process, and divide as numpy does.

    Args:
        options: more of what `numba.njit` takes: `nogil`, `fastmath`, `forceinline`.
    """

    def compiled(function: Callable[..., Any]) -> Any:
        dispatcher: Any = numba.njit(error_model="numpy", **options)(function)
        if dispatcher is not function:  # as it is where compiling is switched off
            dispatcher._cache = _Kept(function)  # what `enable_caching` does, with names of our own
            dispatcher.get_call_template = _whatever_the_number(dispatcher.get_call_template)
        return dispatcher

    return compiled


def _whatever_the_number(template: Callable[..., Any]) -> Callable[..., Any]:
    """One version for all numbers that are written out in a call: the compiler would make one for each of them."""

    def by_type(args: Sequence[Any], kws: Mapping[str, Any]) -> Any:
        return template([unliteral(arg) for arg in args], {name: unliteral(arg) for name, arg in kws.items()})

    return by_type


class _Named(IndexDataCacheFile):
    """A function's versions on disk, each under a name that follows from its types."""

    def save(self, key: Any, data: Any) -> None:
        """The list of versions first, as the compiler does: what it lists and is not there yet is compiled again."""
        name = self._data_name(int.from_bytes(hashlib.sha256(repr(key).encode()).digest()[:8]))
        self._save_index({**self._load_index(), key: name})
        self._save_data(name, data)


class _Kept(FunctionCache):
    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        theirs = self._cache_file
        self._cache_file = _Named(theirs._cache_path, self._impl.filename_base, theirs._source_stamp)
