"""The PAL TIAGo's model file and layout go in; its ``Robot`` description comes out."""

from pathlib import Path

from knowarm.world.robot import Robot, Table

TIAGO = Robot(
    name="tiago",
    title="PAL TIAGo",
    mjcf=Path(__file__).with_name("tiago.xml"),
    joints=tuple(f"arm_{i}_joint" for i in range(1, 8)),
    tcp_site="tcp",
    home=(0.206, -0.036, -1.67, 1.79, 0.57, -0.56, -0.6),
    table=Table(half_size_m=(0.25, 0.35), centre_m=(0.78, -0.08), height_m=0.60),
    # the paper's 20 x 25 cm rectangle
    rectangle_centre_m=(0.70, -0.08),
    rectangle_half_size_m=(0.10, 0.125),
    target_yaw_deg=-135.0,
    camera_position_m=(1.35, -0.95, 1.50),
    camera_look_at_m=(0.66, -0.06, 0.78),
    camera_fovy_deg=34.0,
)
"""PAL TIAGo: 7 arm joints, torso lift fixed at .35 m, two-finger gripper, table."""
