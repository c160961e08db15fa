"""What the report says about each experiment: one file each, with `section(runs) -> Section`."""
