"""Shapes, meshes and point clouds as immutable values, and the files they come from."""
