"""What a robot of a URDF alone works with: where its arms end, its tools, its gripper."""
