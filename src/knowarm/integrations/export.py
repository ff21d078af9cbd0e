"""Export: a folder with the ONNX models of a trained agent, its contract and a reference runner."""

import json
from pathlib import Path

import numpy as np
import torch

from knowarm.experiment.load import TrainedAgent
from knowarm.integrations import runner
from knowarm.integrations.contract import Deployment, deployment
from knowarm.integrations.onnx_export import RECOGNITION_INPUTS, RECOGNITION_OUTPUTS, export_onnx
from knowarm.perception.module import digest
from knowarm.reading import writing


def export(trained: TrainedAgent, folder: Path) -> Deployment:
    """Write models, knowledge table, contract and runner; return what was exported.

    Raises:
        UserError: the folder cannot be written to, or packages are missing.
    """
    parts = deployment(trained)
    with writing(folder, "Give another folder."):
        folder.mkdir(parents=True, exist_ok=True)
        export_onnx(parts.policy, parts.policy.example(), folder / "policy.onnx")
        if parts.recognition is not None:
            image = parts.policy.example()[0]
            example = (image, torch.from_numpy(parts.knowledge[[0, 0]]))
            names = {"inputs": RECOGNITION_INPUTS, "outputs": RECOGNITION_OUTPUTS}
            export_onnx(parts.recognition, example, folder / "recognition.onnx", **names)
        np.save(folder / "knowledge.npy", parts.knowledge)
        (folder / "runner.py").write_bytes(Path(runner.__file__).read_bytes())
        files = sorted(each for each in folder.iterdir() if each.suffix in (".onnx", ".npy"))
        digests = {each.name: digest(each.read_bytes()) for each in files}
        contract = parts.contract | {"digests": digests}
        (folder / "contract.json").write_text(json.dumps(contract, indent=2) + "\n", "utf-8")
    return parts
