"""Play one episode with a served policy.

pip install openpi-client typing-extensions  # in an environment of its own
knowarm serve zoo/irb120-full-fast &
python examples/serve_client.py
"""

import numpy as np
from openpi_client.websocket_client_policy import WebsocketClientPolicy

policy = WebsocketClientPolicy("127.0.0.1", 8000)
contract = policy.get_server_metadata()
angles = np.array(contract["joints"]["home"])  # yours: the measured joint angles [rad]
for _ in range(contract["max_episode_steps"]):
    image = np.zeros((64, 64, 3), np.uint8)  # yours: the camera's image, RGB
    observation = {"observation/image": image, "observation/state": angles}
    # Yours: command these joint angles
    angles = policy.infer(observation)["actions"][0]
print("Last joint targets [rad]:", angles.round(3))
