"""The 3D view. viser draws a scene and its instants, live during a run or later from recordings.

model.py        `ViewScene` (one per view) and `ViewInstant` (many). Independent of viser, runs and logs.
scene.py        Converts the scene that a run records, and its profile, to a `ViewScene`.
shapes.py       Triangles of cylinders, boxes, arrows, propellers, a plain boat, and the water surface.
drawing.py      `SceneDrawing`: shows a `ViewScene` and its instants as nodes of a viser server.
recording.py    `LogScene`: puts logs of runs and vehicles on one time line and in one map.
tracks.py       The data of one vessel over time, read from its log.
replay.py       Shows a `LogScene` on a viser server.
timeline.py     The page of a served `LogScene`.
replay_page.py  One HTML file that plays a `LogScene`.
pictures.py     PNG and GIF pictures.
server.py       The viser server of a page: its address, and the check of each request.
live_view.py    The live view of a run. process.py is its process; messages.py is their pipe.
live_foxglove.py  The live connection to Foxglove, behind live_gate.py, which checks each request.
"""
