"""Integrations: a trained policy outside of the simulator. Each needs an extra of its own.

`export` writes an ONNX model with a contract, which `runner` plays; `serve` and `ros` drive robots
with the same runner. `record` writes datasets, `hub` shares policies, `rerun` writes films.
"""
