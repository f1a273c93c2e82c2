"""Emulated boards: an ARMv7 Debian with its own kernel, clock and scheduler, built from Debian's packages.

recipe.py contents of an image -> packages.py fetch -> image.py unpack, configure -> life.py, emulator.py run it.
"""
