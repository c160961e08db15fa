"""The commands of `python -m sdfbake`, one file each."""
