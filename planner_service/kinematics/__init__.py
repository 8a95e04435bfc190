"""Where the tool is and how to bring it somewhere: inverse kinematics, tool poses as goals, straight tool lines."""
