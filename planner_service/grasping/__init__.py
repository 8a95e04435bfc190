"""Grasps: where a gripper may take an object, and what must hold where its fingers touch."""
