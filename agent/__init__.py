"""What runs on the board: the XITL wire protocol, its timing, and the embedded autopilot.

Python 3.9 syntax and the standard library alone, so that it runs from one file on a small Linux board.
"""

__version__ = "0.1.0"
