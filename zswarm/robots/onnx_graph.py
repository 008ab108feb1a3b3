"""Writes a graph of ONNX, an operation after the other."""

from types import ModuleType
from typing import Any

import numpy as np

OPSET, IR = 13, 7  # of 2020: what runs models on robots knows them


class Graph:
    """A graph that grows; operations are functions of names, and give names.

    Attributes:
        onnx: the package.
    """

    def __init__(self, onnx: ModuleType) -> None:
        self.onnx = onnx
        self._nodes: list[Any] = []
        self._constants: dict[tuple[str, tuple[int, ...], bytes], Any] = {}

    def constant(self, numbers: Any, dtype: Any = np.float32) -> str:
        """An array, or a number."""
        array = np.asarray(numbers, dtype)
        key = array.dtype.str, array.shape, array.tobytes()
        if key not in self._constants:
            self._constants[key] = self.onnx.numpy_helper.from_array(array, f"c{len(self._constants)}")
        name: str = self._constants[key].name
        return name

    def op(self, kind: str, *inputs: str, **attributes: Any) -> str:
        """The first output of an operation of ONNX."""
        name = f"v{len(self._nodes)}"
        self._nodes.append(self.onnx.helper.make_node(kind, list(inputs), [name], **attributes))
        return name

    def cast(self, value: str, dtype: Any) -> str:
        """A value as another type of numbers; what has a fraction is cut."""
        return self.op("Cast", value, to=self.onnx.helper.np_dtype_to_tensor_dtype(np.dtype(dtype)))

    def part(self, value: str, begin: int, end: int) -> str:
        """Some of a row's numbers."""
        return self.op("Slice", value, self.constant([begin], np.int64), self.constant([end], np.int64))

    def shaped(self, value: str, *shape: int) -> str:
        """The same numbers in another shape."""
        return self.op("Reshape", value, self.constant(shape, np.int64))

    def finished(self, name: str, inputs: dict[str, tuple[Any, int]], outputs: dict[str, tuple[str, Any, int]]) -> Any:
        """The model.

        Args:
            inputs: of each name the type of its numbers, and how many they are.
            outputs: likewise, before these the value that they are.
        """
        helper = self.onnx.helper

        def row(name: str, dtype: Any, length: int) -> Any:
            return helper.make_tensor_value_info(name, helper.np_dtype_to_tensor_dtype(np.dtype(dtype)), [length])

        for output, (value, _, _) in outputs.items():
            self._nodes.append(helper.make_node("Identity", [value], [output]))
        graph = helper.make_graph(
            self._nodes,
            name,
            [row(input_, dtype, length) for input_, (dtype, length) in inputs.items()],
            [row(output, dtype, length) for output, (_, dtype, length) in outputs.items()],
            list(self._constants.values()),
        )
        return helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR)
