"""The ABB IRB120's model file and layout go in; its ``Robot`` description comes out."""

from pathlib import Path

from knowarm.world.robot import Robot

IRB120 = Robot(
    name="irb120",
    title="ABB IRB120",
    mjcf=Path(__file__).with_name("irb120.xml"),
    joints=("joint_1", "joint_2", "joint_3", "joint_4", "joint_5", "joint_6"),
    tcp_site="tcp",
    home=(0.0, 0.0, 0.4, 0.0, 0.2, 0.0),
    # the paper's 60 x 20 cm rectangle, on the floor in front of the robot
    rectangle_centre_m=(0.47, 0.0),
    rectangle_half_size_m=(0.10, 0.30),
    # the mug's handle and the bottle are turned so that the wrist stays within its range
    target_yaw_deg=-165.0,
    target_yaws_deg={"cereal_box": -135.0},
    # on the robot's right front, framing the workspace and not the robot
    camera_position_m=(1.25, -0.90, 0.95),
    camera_look_at_m=(0.42, -0.03, 0.20),
    camera_fovy_deg=40.0,
)
"""ABB IRB120: 6 joints, reach .580 m to the wrist centre, two-finger gripper."""
