"""Emulated boards: an ARMv7 Debian with its own kernel, clock and scheduler, made of Debian's packages.

recipe.py what is in an image -> packages.py fetch -> image.py unpack, configure -> keys.py, emulator.py run it.
"""
