"""Networks as files: ``.cfg`` and ``.weights``, ONNX, pruning, quantisation, the PyTorch module."""
