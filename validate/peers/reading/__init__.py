"""Programs that read exported grids, one file each, in whatever Python has them: NumPy, and nothing of ours."""
