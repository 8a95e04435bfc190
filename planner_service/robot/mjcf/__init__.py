"""Reading MJCF files with mujoco."""
