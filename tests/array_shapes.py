"""Shapes and kinds of arrays, checked in every call while tests run: `pytest -p array_shapes --shapes FILE`.

Only jaxtyping's annotations are looked at. A name of an axis has one length within one call. A call that ends in an
error is left out: tests give wrong arrays on purpose.
"""

from __future__ import annotations

import ast
import functools
import importlib
import inspect
import json
import pkgutil
import sys
import types
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Union, get_args, get_origin, get_type_hints

import pytest
from jaxtyping import AbstractArray, jaxtyped

PACKAGES = ("petkin", "petkin_bench")
#: Of annotations that hold arrays only within these, the arrays are looked at.
_ALL_ALIKE = (list, Sequence)
_UNIONS = (Union, types.UnionType)


@dataclass
class Tally:
    """What was checked: functions with annotations of arrays by name, those called, and what does not hold."""

    annotated: set[str] = field(default_factory=set)
    called: set[str] = field(default_factory=set)
    unread: dict[str, str] = field(default_factory=dict)
    violations: dict[str, str] = field(default_factory=dict)

    def write(self, path: Path) -> None:
        sets = {"annotated": sorted(self.annotated), "called": sorted(self.called)}
        path.write_text(json.dumps({**sets, "unread": self.unread, "violations": self.violations}, indent=1))


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--shapes", type=Path, help="File for what the check of shapes found.")


def pytest_configure(config: pytest.Config) -> None:
    tally = Tally()
    check_packages(tally)
    config.add_cleanup(lambda: tally.write(config.getoption("--shapes")))


def check_packages(tally: Tally) -> None:
    """Put a checked function in the place of every one whose annotations name arrays, wherever it is known."""
    modules = list(_modules())
    checked = functools.cache(functools.partial(_checked, tally))
    for module in modules:
        for name, value in list(vars(module).items()):
            _replace(module, name, value, checked)
            if inspect.isclass(value) and value.__module__ == module.__name__:
                _check_class(value, checked)


def _check_class(kind: type, checked: Callable[[Any], Any]) -> None:
    if getattr(kind, "_is_protocol", False):
        return  # says what others do
    known = tuple(base.__module__ for base in kind.__mro__ if _is_ours(base))
    checked = functools.partial(checked, modules=known)
    for name, value in list(vars(kind).items()):
        if isinstance(value, functools.cached_property):
            value.func = checked(value.func)
        elif isinstance(value, property):
            setattr(kind, name, property(value.fget and checked(value.fget), value.fset, value.fdel, value.__doc__))
        elif isinstance(value, classmethod | staticmethod):
            setattr(kind, name, type(value)(checked(value.__func__)))
        elif inspect.isclass(value) and value.__qualname__ == f"{kind.__qualname__}.{name}":
            _check_class(value, checked)
        else:
            _replace(kind, name, value, checked)


def _replace(owner: Any, name: str, value: Any, checked: Callable[[Any], Any]) -> None:
    if isinstance(value, types.FunctionType | functools._lru_cache_wrapper):
        found = checked(value)
        if found is not value:
            setattr(owner, name, found)


def _modules() -> Iterator[types.ModuleType]:
    for package in map(importlib.import_module, PACKAGES):
        yield package
        for found in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if not found.name.endswith("__main__"):
                yield importlib.import_module(found.name)


def _is_ours(thing: Any) -> bool:
    return thing.__module__.split(".")[0] in PACKAGES


def _checked(tally: Tally, function: Any, modules: tuple[str, ...] = ()) -> Any:
    """The function with its arrays checked; as it is where it names none, or is not Python's own.

    Args:
        modules: of its class and of those that this comes from: a dataclass repeats the annotations of all.
    """
    if isinstance(function, functools._lru_cache_wrapper):
        inside = _checked(tally, function.__wrapped__, modules)
        return (
            function if inside is function.__wrapped__ else functools.lru_cache(**function.cache_parameters())(inside)
        )
    if not isinstance(function, types.FunctionType) or not _is_ours(function):
        return function
    where = f"{function.__module__}.{function.__qualname__}"
    try:
        read = get_type_hints(function, _names((function.__module__, *modules)))
    except Exception as error:
        tally.unread[where] = str(error)
        return function
    hints = {name: hint for name, hint in read.items() if names_arrays(hint)}
    if not hints:
        return function
    tally.annotated.add(where)
    return watched(function, hints, where, tally)


@functools.cache
def _names(modules: tuple[str, ...]) -> dict[str, Any]:
    """Names that annotations may use; the first module comes first."""
    return {name: value for module in reversed(modules) for name, value in _names_of(module).items()}


@functools.cache
def _names_of(module: str) -> dict[str, Any]:
    """Names of a module, with those that it imports for checkers of types alone."""
    names = dict(vars(sys.modules[module]))
    for node in ast.parse(inspect.getsource(sys.modules[module])).body:
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            exec(compile(ast.Module(node.body, []), module, "exec"), names)
    return names


def watched(function: Any, hints: Mapping[str, Any], where: str, tally: Tally) -> Any:
    """The same function; every call that returns is checked against annotations of its arguments and its result."""
    signature = inspect.signature(function)

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        tally.called.add(where)
        with jaxtyped("context"):
            given = signature.bind(*args, **kwargs).arguments
            wrong = [name for name in hints if name in given and not conforms(given[name], hints[name])]
            result = function(*args, **kwargs)
            values = {**given, "return": result}
            if "return" in hints and not conforms(result, hints["return"]):
                wrong.append("return")
        for name in wrong:
            tally.violations.setdefault(f"{where}, {name}", f"{hints[name]} is not so of {described(values)}")
        return result

    return call


def described(values: Mapping[str, Any]) -> str:
    """Kinds and shapes of the arrays among values."""
    return ", ".join(f"{name}: {_described(value)}" for name, value in values.items() if name != "self")


def _described(value: Any) -> str:
    if isinstance(value, tuple | list):
        return f"({', '.join(map(_described, value))})"
    shape = getattr(value, "shape", None)
    return type(value).__name__ if shape is None else f"{value.dtype} {tuple(shape)}"


def names_arrays(hint: Any) -> bool:
    """Whether a type is an annotation of arrays or is made of such, as far as `conforms` looks."""
    if _is_array(hint):
        return True
    made_of = get_origin(hint) in (*_UNIONS, tuple, dict, *_ALL_ALIKE) and Any not in get_args(hint)
    return made_of and any(map(names_arrays, get_args(hint)))


def conforms(value: Any, hint: Any) -> bool:
    """Whether the arrays in a value have the shapes of their annotations; all else is taken as it is."""
    kind, parts = get_origin(hint), get_args(hint)
    if _is_array(hint):
        return isinstance(value, hint)
    if kind in _UNIONS:
        arrays = [part for part in parts if names_arrays(part)]
        scalar = float in parts and isinstance(value, float)  # numpy's has a shape too
        return scalar or not hasattr(value, "shape") or any(conforms(value, part) for part in arrays)
    if kind is tuple and parts[-1:] != (...,):
        return len(value) == len(parts) and all(map(conforms, value, parts))
    if kind in (tuple, *_ALL_ALIKE):
        return all(conforms(each, parts[0]) for each in value)
    return kind is not dict or all(conforms(each, parts[1]) for each in value.values())


def _is_array(hint: Any) -> bool:
    return inspect.isclass(hint) and issubclass(hint, AbstractArray)
