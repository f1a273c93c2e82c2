"""Missions drawn elsewhere: files of ground stations, chart plotters and map editors, brought into a profile."""
