"""Trajectories and proofs in the formats of other tools, and explanations as a server answers them."""
