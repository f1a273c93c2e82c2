"""Nodes of a run, one subject a file. run/composition declares when a run has each of them."""
