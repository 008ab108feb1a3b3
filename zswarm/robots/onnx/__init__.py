"""Controllers as ONNX graphs."""
