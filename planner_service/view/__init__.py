"""Pictures of robots, scenes and plans: their geometry as triangles, and a still made of it without a display."""
