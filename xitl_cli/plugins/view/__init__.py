"""The 3D view. viser draws a scene and its instants, live during a run or later from recordings.

model.py        `ViewScene` (one per view) and `ViewInstant` (many). Independent of viser, runs and logs.
scene.py        Converts the scene that a run records, and its profile, to a `ViewScene`.
shapes.py       Triangles of cylinders, boxes, arrows, propellers and a plain boat.
water.py        The water surface as a grid that the waves of the run move.
drawing.py      `SceneDrawing`: shows a `ViewScene` and its instants as nodes of a viser server.
recording.py    `LogScene`: puts logs of runs and vehicles on one time line and in one map.
tracks.py       The data of one vessel over time, read from its log.
replay.py       Shows a `LogScene` on a viser server.
timeline.py     The page of a served `LogScene`.
replay_page.py  One HTML file that plays a `LogScene`.
pictures.py     PNG and GIF pictures.
"""
