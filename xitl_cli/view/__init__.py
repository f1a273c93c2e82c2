"""The 3D view: a scene and instants of it, drawn by viser; beside a run as it goes on, and of recordings afterwards.

model.py       ViewScene (once), ViewInstant (many): all that is drawn. Knows no viser, no run and no log
"""
