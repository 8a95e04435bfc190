"""Xacro files: expanded into URDF where they can do nothing but compute and read their own package."""
