"""What is made of several plans: pick, place, straight tool moves, and the best plan of several seeds."""
