"""Program on the board: the XITL wire protocol, its timing, and the embedded autopilot.

It uses Python 3.9 syntax and only the standard library, so that it runs from one file on a small Linux board.
"""

__version__ = "1.0.0"
