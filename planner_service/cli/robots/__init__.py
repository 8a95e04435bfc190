"""What the commands of ``robot`` say of a robot's file: what is wrong in it, and what was found in it."""
