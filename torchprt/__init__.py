"""Precomputed radiance transfer for PyTorch: bake once, relight in real time, export to ONNX."""
