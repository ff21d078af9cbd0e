"""Deployment: a trained policy outside of the simulator. Each way needs an extra of its own.

`contract` exports an ONNX model with its contract, which `runner` plays; `serve` and `ros` drive
robots with the same runner. `record` writes datasets.
"""
