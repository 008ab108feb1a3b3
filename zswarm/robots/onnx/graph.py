"""Writes an ONNX graph: arithmetic on its values adds operations."""

from collections.abc import Callable
from types import ModuleType
from typing import Any

import numpy as np

OPSET, IR = 13, 7  # of 2020, for the runtimes of robots


Operator = Callable[["OnnxValue", Any], "OnnxValue"]


def _operator(kind: str) -> tuple[Operator, Operator]:
    """Return the methods of an operator with a value on its left, and on its right."""
    return (
        lambda self, other: self.graph.op(kind, self, other),
        lambda self, other: self.graph.op(kind, other, self),
    )


class OnnxValue:
    """A value in a graph. In operations, numbers and arrays become constants of its type."""

    __array_ufunc__ = None  # numpy leaves operators to this class

    def __init__(self, graph: "OnnxGraph", name: str, dtype: Any) -> None:
        self.graph, self.name, self.dtype = graph, name, dtype

    def op(self, kind: str, *others: Any, **options: Any) -> "OnnxValue":
        """Add an operation whose first input this is."""
        return self.graph.op(kind, self, *others, **options)

    __add__, __radd__ = _operator("Add")
    __sub__, __rsub__ = _operator("Sub")
    __mul__, __rmul__ = _operator("Mul")
    __truediv__, __rtruediv__ = _operator("Div")
    __matmul__, __rmatmul__ = _operator("MatMul")

    def __getitem__(self, part: slice) -> "OnnxValue":
        begin, end = (
            self.graph.constant([at], np.int64) for at in (part.start, part.stop)
        )
        return self.op("Slice", begin, end)

    def cast(self, dtype: Any) -> "OnnxValue":
        """Convert to another type; fractions are cut."""
        to = self.graph.onnx.helper.np_dtype_to_tensor_dtype(np.dtype(dtype))
        return self.op("Cast", dtype=dtype, to=to)

    def clip(self, least: Any, most: Any) -> "OnnxValue":
        """Limit to a range."""
        return self.op("Max", least).op("Min", most)

    def shaped(self, *shape: int) -> "OnnxValue":
        """Return the same numbers in another shape."""
        return self.op("Reshape", self.graph.constant(shape, np.int64))


class OnnxGraph:
    """A graph that grows.

    Attributes:
        onnx: the package.
    """

    def __init__(self, onnx: ModuleType) -> None:
        self.onnx = onnx
        self._nodes: list[Any] = []
        self._constants: dict[tuple[str, tuple[int, ...], bytes], Any] = {}

    def constant(self, numbers: Any, dtype: Any = np.float32) -> OnnxValue:
        """Add an array, or a number."""
        array = np.asarray(numbers, dtype)
        key = array.dtype.str, array.shape, array.tobytes()
        if key not in self._constants:
            name = f"c{len(self._constants)}"
            self._constants[key] = self.onnx.numpy_helper.from_array(array, name)
        return OnnxValue(self, self._constants[key].name, dtype)

    def op(
        self, kind: str, *inputs: Any, dtype: Any = None, **attributes: Any
    ) -> OnnxValue:
        """Add an operation; its output has a dtype, or that of the first input."""
        of = next(each.dtype for each in inputs if isinstance(each, OnnxValue))
        values = [
            each if isinstance(each, OnnxValue) else self.constant(each, of)
            for each in inputs
        ]
        name, names = f"v{len(self._nodes)}", [value.name for value in values]
        self._nodes.append(self.onnx.helper.make_node(kind, names, [name], **attributes))
        return OnnxValue(self, name, dtype or of)

    def concat(self, *values: OnnxValue) -> OnnxValue:
        """Join rows."""
        return self.op("Concat", *values, axis=0)

    def where(self, test: OnnxValue, yes: OnnxValue, no: OnnxValue) -> OnnxValue:
        """Choose by a condition."""
        return self.op("Where", test, yes, no, dtype=yes.dtype)

    def model(
        self,
        name: str,
        inputs: dict[str, tuple[Any, int]],
        outputs: dict[str, tuple[OnnxValue, int]],
    ) -> Any:
        """Return the model; its inputs have types and lengths, its outputs values and lengths."""
        helper = self.onnx.helper

        def row(name: str, dtype: Any, length: int) -> Any:
            kind = helper.np_dtype_to_tensor_dtype(np.dtype(dtype))
            return helper.make_tensor_value_info(name, kind, [length])

        for output, (value, _) in outputs.items():
            self._nodes.append(helper.make_node("Identity", [value.name], [output]))
        graph = helper.make_graph(
            self._nodes,
            name,
            [row(name, dtype, length) for name, (dtype, length) in inputs.items()],
            [row(name, value.dtype, length) for name, (value, length) in outputs.items()],
            list(self._constants.values()),
        )
        opsets = [helper.make_opsetid("", OPSET)]
        return helper.make_model(graph, opset_imports=opsets, ir_version=IR)
