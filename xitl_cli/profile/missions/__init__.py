"""Missions from other programs: files of ground stations, chart plotters and map editors, read into a profile."""
