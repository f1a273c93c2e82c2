"""Numpy functions of one vessel, recorded once and run by compiled code for any number of vessels.

The physics is written in numpy. `record` runs such a function on arrays that record each operation on a tape. A small C
program (kernel.c) runs the tape without numpy's cost per call. The C program knows arithmetic only, and no physics.
"""
