"""Declare kernels, which numba compiles on first call; results are bitwise equal on all machines.

Only ``compiler.py`` imports numba, so a process that evaluates nothing starts without it. With
``ZSWARM_PLAIN=1`` kernels remain Python functions, which compute the same bits slowly: for tests.
"""

import contextlib
import functools
import os
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from zswarm.kernels.lanes import sqrt
from zswarm.kernels.signatures import (
    STEP,
    STEP_SIGNATURE,
    Step,
    array,
    float32,
    float64,
    int32,
    int64,
    uint8,
    uint64,
    void,
)

__all__ = [
    "STEP",
    "STEP_SIGNATURE",
    "Compiled",
    "Step",
    "array",
    "compile_all",
    "float32",
    "float64",
    "inline",
    "int32",
    "int64",
    "interpreted",
    "kernel",
    "sqrt",
    "uint8",
    "uint64",
    "void",
]

PLAIN = os.environ.get("ZSWARM_PLAIN", "") == "1"
if PLAIN:
    np.seterr(over="ignore")  # kernels rely on integers that wrap


class Compiled(functools.partial[Any]):
    """A function that is compiled on first call, or when a kernel that calls it is compiled.

    Once compiled, a call reaches numba's dispatcher without a Python function in between:
    simulators call small kernels several times per step.

    Attributes:
        py_func: the Python function.
        signature: as ``void`` returns it; with None, numba compiles once per combination of
            argument types.
        options: further options of ``numba.njit``.
    """

    py_func: Callable[..., Any]
    signature: tuple[Any, ...] | None
    options: dict[str, Any]

    def __new__(
        cls,
        function: Callable[..., Any],
        signature: tuple[Any, ...] | None,
        **options: Any,
    ) -> "Compiled":
        """Declare a function; nothing is compiled yet."""
        self = super().__new__(cls, function)
        functools.update_wrapper(self, function)
        self.py_func, self.signature, self.options = function, signature, options
        _declared.append(self)
        self.choose()
        return self

    def __reduce__(self) -> str:  # a global, for copy and pickle
        return self.py_func.__qualname__

    @functools.cached_property
    def dispatcher(self) -> Any:
        """Return numba's dispatcher; compile the function on first access."""
        # It imports numba, which takes a third of a second.
        from zswarm.kernels import compiler

        return compiler.compiled(self.py_func, self.signature, self.options)

    @property
    def _numba_type_(self) -> Any:
        """Return the numba type; numba asks for it when a kernel refers to the function."""
        return self.dispatcher._numba_type_

    def choose(self) -> None:
        """Choose what a call reaches: inside ``interpreted`` the Python function."""
        reached = self.py_func
        if not _interpreting:
            takes_step = self.signature is not None and STEP in self.signature[:1]
            reached = self._play if takes_step else self._compile
        self._reach(reached)

    def _reach(self, function: Callable[..., Any]) -> None:
        state: Any = function, (), {}, self.__dict__  # of a ``functools.partial``
        self.__setstate__(state)  # type: ignore[attr-defined]  # typeshed does not know it

    def _compile(self, *arguments: Any) -> Any:
        self._reach(self.dispatcher)
        return self.dispatcher(*arguments)

    def _play(self, step: Any, *arguments: Any) -> Any:
        if isinstance(step, Compiled):
            step = step.dispatcher
        return self.dispatcher(step, *arguments)


_interpreting = False
_declared: list[Compiled] = []
_kernels: list[Compiled] = []


def kernel(signature: tuple[Any, ...]) -> Any:
    """Declare a function that is called from Python, with its signature.

    It is compiled strictly: no fast-math, no reordering, division by zero as in numpy.
    """

    def declare(function: Callable[..., Any]) -> Any:
        if PLAIN:
            return function
        # A step makes no arrays, so numba need not count references to its arguments.
        options = {"_nrt": False} if signature == STEP_SIGNATURE else {}
        _kernels.append(Compiled(function, signature, **options))
        return _kernels[-1]

    return declare


def inline(
    function: Any = None, *, counts: bool = True, inner: bool = False, copied: bool = True
) -> Any:
    """Declare a function that kernels call.

    Args:
        counts: if False, the function is inlined and numba does not count references to arrays,
            which takes two atomic additions for each array argument or row. Such a function must
            neither make nor return arrays, nor call one that does.
        copied: if False, such a function is called instead of inlined: for large ones, which the
            compiler takes much memory to inline.
        inner: if True, only compiled functions may call it, which saves a sixth of the compile
            time; a call from Python crashes.
    """
    if function is None:
        return functools.partial(inline, counts=counts, inner=inner, copied=copied)
    if PLAIN:
        return function
    options: dict[str, Any] = {} if counts else {"_nrt": False, "forceinline": copied}
    if inner:
        options |= {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    return Compiled(function, None, **options)


def compile_all(report: Callable[[int, int], None] | None = None) -> None:
    """Compile all kernels of the imported modules, so that no trial waits for the compiler.

    Args:
        report: is called before each kernel that no program compiled before, so that it takes a
            while, with how many of these are missing and how many there were.
    """
    new = _new()
    for declared in _kernels:
        missing = [one for one in new if "dispatcher" not in one.__dict__]
        if report is not None and declared in missing:
            report(len(missing), len(new))
        _ = declared.dispatcher


def _new() -> list[Compiled]:
    """Return the kernels that no program compiled before."""
    waiting = [one for one in _kernels if "dispatcher" not in one.__dict__]
    if not waiting:
        return []
    from zswarm.kernels import compiler  # which imports numba

    return [one for one in waiting if not compiler.is_cached(one.py_func)]


@contextlib.contextmanager
def interpreted() -> Iterator[None]:
    """Run kernels as Python functions: a few steps take less time than importing the compiler."""
    before = _interpreting
    _switch(interpreting=True)
    try:
        with np.errstate(over="ignore"):
            yield
    finally:
        _switch(interpreting=before)


def _switch(*, interpreting: bool) -> None:
    global _interpreting  # kernels are shared by the whole process
    _interpreting = interpreting
    for function in _declared:
        function.choose()
