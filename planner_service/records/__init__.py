"""Plans, tasks, problems and trajectories in files; what is read from a file is proven again before it is used."""
