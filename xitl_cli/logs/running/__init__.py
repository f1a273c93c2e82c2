"""How the programs of a run kept their time, whichever log tells it.

loops.py       PM rows of ArduPilot by meaning, through the names of its versions; where they are evidence of anything
deadlines.py   deadlines of periodic tasks and those that were missed
moments.py     what happened, to lay beside a long loop or a missed deadline
"""
