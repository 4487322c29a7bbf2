"""A model's short formulas, and their derivatives, as a list of operations that compiled loops run over many curves.

A formula is plain arithmetic, so calling it once with `Node`s instead of numbers writes down what it does; what it does
twice is written down once. Compiled code then needs to know nothing of a model, and a new model no compilation.

Every operation is one rounding, so that a curve's numbers do not depend on its neighbours.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from petkin.fitting.dual import Dual
from petkin.fitting.lanes import LANES
from petkin.jit import njit

_CONSTANT, _INPUT, _ADD, _SUBTRACT, _MULTIPLY, _DIVIDE, _POWER, _ROOT = range(8)

#: Curves that an operation runs over: registers of a dozen live numbers fit the first-level cache.
WIDTH = LANES


class Tape(NamedTuple):
    """Operations on registers of WIDTH numbers.

    Args:
        steps: operation, target, left and right register (S, 4).
        constants: what the first registers after the inputs hold (C,).
        outputs: registers of the results (Q,).
        registers: how many there are; the inputs are the first.
        inputs: how many of them are inputs.
    """

    steps: NDArray[np.int64]
    constants: NDArray[np.float64]
    outputs: NDArray[np.int64]
    registers: int
    inputs: int

    def memory(self) -> NDArray[np.float64]:
        """Registers, constants in place (registers, WIDTH)."""
        memory = np.zeros((self.registers, WIDTH))
        memory[self.inputs : self.inputs + len(self.constants)] = self.constants[:, None]
        return memory


@dataclass(frozen=True, slots=True)
class Node:
    """A number that is yet to be known."""

    recorder: _Recorder
    index: int

    #: Arrays leave arithmetic with a Node to the Node.
    __array_ufunc__ = None

    def __add__(self, other: Any) -> Node:
        return self.recorder.apply(_ADD, self, other)

    def __radd__(self, other: Any) -> Node:
        return self.recorder.apply(_ADD, other, self)

    def __sub__(self, other: Any) -> Node:
        return self.recorder.apply(_SUBTRACT, self, other)

    def __rsub__(self, other: Any) -> Node:
        return self.recorder.apply(_SUBTRACT, other, self)

    def __mul__(self, other: Any) -> Node:
        return self.recorder.apply(_MULTIPLY, self, other)

    def __rmul__(self, other: Any) -> Node:
        return self.recorder.apply(_MULTIPLY, other, self)

    def __truediv__(self, other: Any) -> Node:
        return self.recorder.apply(_DIVIDE, self, other)

    def __rtruediv__(self, other: Any) -> Node:
        return self.recorder.apply(_DIVIDE, other, self)

    def __neg__(self) -> Node:
        return self.recorder.apply(_MULTIPLY, self, -1.0)

    def __pow__(self, power: float) -> Node:
        return self.recorder.apply(_ROOT, self, self) if power == 0.5 else self.recorder.apply(_POWER, self, power)


class _Recorder:
    """What has been written down: (operation, left, right) of every node, each once."""

    def __init__(self, inputs: int) -> None:
        self.entries: dict[tuple[Any, ...], int] = {(_INPUT, i, 0): i for i in range(inputs)}

    def node(self, *entry: Any) -> Node:
        return Node(self, self.entries.setdefault(entry, len(self.entries)))

    def apply(self, operation: int, left: Any, right: Any) -> Node:
        left, right = (n if isinstance(n, Node) else self.node(_CONSTANT, float(n), 0) for n in (left, right))
        return self.node(operation, left.index, right.index)


def record(function: Callable[..., Any], inputs: int) -> Tape:
    """The tape of a function of so many numbers, whose results are numbers or None in a flat tuple."""
    recorder = _Recorder(inputs)
    results = function(*(recorder.node(_INPUT, i, 0) for i in range(inputs)))
    wanted = [r.index if isinstance(r, Node) else recorder.node(_CONSTANT, float(r), 0).index for r in results]
    return _allocate(list(recorder.entries), wanted, inputs)


def record_partials(function: Callable[..., Any], inputs: int) -> Tape:
    """The tape of a function of P numbers with Q results: Q values, then P derivatives of each of them."""

    def with_slopes(*arguments: Node) -> tuple[Any, ...]:
        results = function(*(Dual(node, {p: 1.0}) for p, node in enumerate(arguments)))
        duals = [r if isinstance(r, Dual) else Dual(r, {}) for r in results]
        return (*(d.value for d in duals), *(d.slopes.get(p, 0.0) for d in duals for p in range(inputs)))

    return record(with_slopes, inputs)


def _allocate(entries: list[tuple[Any, ...]], wanted: list[int], inputs: int) -> Tape:
    """Registers for every node that leads to a wanted one; a register is free again after its last use."""
    last_use = dict.fromkeys(wanted, len(entries))
    for index in range(len(entries) - 1, -1, -1):
        operation, left, right = entries[index]
        if index in last_use and operation not in (_CONSTANT, _INPUT):
            for operand in (left, right):
                last_use.setdefault(operand, index)
    constants = [i for i in last_use if entries[i][0] == _CONSTANT]
    register = {i: i for i in range(inputs)} | {node: inputs + c for c, node in enumerate(constants)}
    count, spare, steps = len(register), [], []
    for index, (operation, left, right) in enumerate(entries):
        if index not in last_use or operation in (_CONSTANT, _INPUT):
            continue
        if not spare:
            spare.append(count)
            count += 1
        register[index] = spare.pop()  # never an operand's own register: compiled loops may count on that
        steps.append((operation, register[index], register[left], register[right]))
        for operand in {left, right}:
            if last_use[operand] == index and entries[operand][0] not in (_CONSTANT, _INPUT):
                spare.append(register[operand])
    return Tape(
        np.array(steps, np.int64).reshape(-1, 4),
        np.array([entries[i][1] for i in constants]),
        np.array([register[i] for i in wanted], np.int64),
        count,
        inputs,
    )


@njit(nogil=True)
def run(steps, memory):
    """Carry out a tape on registers whose first hold the inputs."""
    # A width that the compiler does not know keeps it from writing the loops out before it puts them into registers.
    width = memory.shape[1]
    for step in range(steps.shape[0]):
        operation = steps[step, 0]
        target, left, right = memory[steps[step, 1]], memory[steps[step, 2]], memory[steps[step, 3]]
        if operation == _ADD:
            for n in range(width):
                target[n] = left[n] + right[n]
        elif operation == _SUBTRACT:
            for n in range(width):
                target[n] = left[n] - right[n]
        elif operation == _MULTIPLY:
            for n in range(width):
                target[n] = left[n] * right[n]
        elif operation == _DIVIDE:
            for n in range(width):
                target[n] = left[n] / right[n]
        elif operation == _ROOT:
            for n in range(width):
                target[n] = np.sqrt(left[n])
        else:
            for n in range(width):
                target[n] = left[n] ** right[n]
