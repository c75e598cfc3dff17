"""Surrogates in other forms: plain NumPy arrays, torch.export, ONNX."""
