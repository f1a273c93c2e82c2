"""The 3D view: a scene and instants of it, drawn by viser; beside a run as it goes on, and of recordings afterwards.

model.py       ViewScene (once), ViewInstant (many): all that is drawn. Knows no viser, no run and no log
scene.py       the scene that a run records, and its profile, to a ViewScene
shapes.py      triangles: cylinders, boxes, arrows, propellers, a plain boat
water.py       the surface as a grid that the waves of the run move
drawing.py     SceneDrawing: a ViewScene and its instants as nodes of a viser server
recording.py   LogScene: logs of runs and vehicles on one time line and in one map -> ViewScene, ViewInstant at any time
tracks.py      what a log tells of one vessel over time
replay.py      a LogScene on a server; timeline.py: its page; replay_page: one file that plays it; pictures.py: PNG, GIF
"""
